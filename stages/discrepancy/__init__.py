"""Where a simulation and what was measured disagree, which named effect is missing, and what it takes away.

A `Cell` is one channel of one element of a machine. `prepare` fits its nominal constants and its noise; `search` names
effects and adds them; `locate` tells in which regimes the gap lies.
"""

from stages.discrepancy.amendment import amend, estimate_intervals
from stages.discrepancy.cell import Cell, Driver, Form
from stages.discrepancy.description import (
    Description,
    DescriptionSettings,
    average_dependence,
    describe,
    describe_above_floor,
    tabulate,
)
from stages.discrepancy.exactness import explain_exactly
from stages.discrepancy.fitted_cell import CellState, prepare
from stages.discrepancy.gaps import locate, upper_ratio
from stages.discrepancy.judgement import Judgement, judge, tell_truth
from stages.discrepancy.machines import Measurements, check_plant, list_cells, settle, write_amended
from stages.discrepancy.odd_trials import find_odd_trials
from stages.discrepancy.parts import PURPOSES, Parts, assign_parts, leave_gaps
from stages.discrepancy.ranking import rank_first
from stages.discrepancy.remainder import sum_doubt, weigh_remainder
from stages.discrepancy.resampling import resample
from stages.discrepancy.residuals import Seen, average_loops, average_plane
from stages.discrepancy.restoring import list_residuals, restore, restore_states
from stages.discrepancy.search import Search, search
from stages.discrepancy.session import build_cells
from stages.discrepancy.settings import DiscrepancySettings, choose_verification
from stages.discrepancy.signature import trace_effects
from stages.discrepancy.verdict import (
    confirm_effects,
    confirm_status,
    decide_status,
    describe_effects,
    list_absorbed,
    list_candidates,
    list_remainder,
    locate_most,
    summarise_unexplained,
)
from stages.discrepancy.verification import (
    Verified,
    bound_ratio,
    compare_steps,
    is_hidden,
    list_hidden,
    list_predictions,
    verify,
)
from stages.discrepancy.words import (
    tell,
    tell_bounds,
    tell_few,
    tell_floor,
    tell_odd,
    tell_remainder,
    tell_scales,
    tell_silent,
    tell_unconfirmed,
)

__all__ = [
    "PURPOSES",
    "Cell",
    "CellState",
    "Description",
    "DescriptionSettings",
    "DiscrepancySettings",
    "Driver",
    "Form",
    "Judgement",
    "Measurements",
    "Parts",
    "Search",
    "Seen",
    "Verified",
    "amend",
    "assign_parts",
    "average_dependence",
    "average_loops",
    "average_plane",
    "bound_ratio",
    "build_cells",
    "check_plant",
    "choose_verification",
    "compare_steps",
    "confirm_effects",
    "confirm_status",
    "decide_status",
    "describe",
    "describe_above_floor",
    "describe_effects",
    "estimate_intervals",
    "explain_exactly",
    "find_odd_trials",
    "is_hidden",
    "judge",
    "leave_gaps",
    "list_absorbed",
    "list_candidates",
    "list_cells",
    "list_hidden",
    "list_predictions",
    "list_remainder",
    "list_residuals",
    "locate",
    "locate_most",
    "prepare",
    "rank_first",
    "resample",
    "restore",
    "restore_states",
    "search",
    "settle",
    "sum_doubt",
    "summarise_unexplained",
    "tabulate",
    "tell",
    "tell_bounds",
    "tell_few",
    "tell_floor",
    "tell_odd",
    "tell_remainder",
    "tell_scales",
    "tell_silent",
    "tell_truth",
    "tell_unconfirmed",
    "trace_effects",
    "upper_ratio",
    "verify",
    "weigh_remainder",
    "write_amended",
]
