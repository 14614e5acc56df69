"""Figures: frames flow in, matplotlib figures flow out."""

from stages.figures.agreement import draw_agreement
from stages.figures.calibration import draw_calibration
from stages.figures.candidate_ranking import draw_candidate_ranking
from stages.figures.channel_lines import draw_channel_lines
from stages.figures.chosen_trials import draw_chosen_trials
from stages.figures.effect_signature import draw_effect_signature
from stages.figures.error_bars import draw_error_bars
from stages.figures.force_surfaces import draw_force_surfaces
from stages.figures.frequent_references import draw_frequent_references
from stages.figures.gap_bars import draw_gap_bars
from stages.figures.gap_map import draw_gap_map
from stages.figures.gap_waterfall import draw_gap_waterfall
from stages.figures.learning_curves import draw_learning_curves
from stages.figures.protocol_commands import draw_protocol
from stages.figures.residual_loops import draw_residual_loops
from stages.figures.residual_plane import draw_residual_plane
from stages.figures.rival_curves import draw_rival_curves
from stages.figures.scores import draw_confusion, draw_rates, draw_said_against_right
from stages.figures.sensitivity import draw_sensitivity
from stages.figures.shift_curves import draw_shift_curves
from stages.figures.unexplained import draw_unexplained
from stages.figures.verified_trials import draw_verified_trials

__all__ = [
    "draw_agreement",
    "draw_calibration",
    "draw_candidate_ranking",
    "draw_channel_lines",
    "draw_chosen_trials",
    "draw_confusion",
    "draw_effect_signature",
    "draw_error_bars",
    "draw_force_surfaces",
    "draw_frequent_references",
    "draw_gap_bars",
    "draw_gap_map",
    "draw_gap_waterfall",
    "draw_learning_curves",
    "draw_protocol",
    "draw_rates",
    "draw_residual_loops",
    "draw_residual_plane",
    "draw_rival_curves",
    "draw_said_against_right",
    "draw_sensitivity",
    "draw_shift_curves",
    "draw_unexplained",
    "draw_verified_trials",
]
