"""Figures of gaps: axes in words and in the unit of what they show, nothing beyond the frame."""

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from stages.science.discrepancy.residuals import average_loops, average_plane
from stages.science.figures.located_gap import draw_residual_loops, draw_residual_plane
from stages.science.figures.proposed_trial import draw_proposed_trial
from stages.science.figures.verified_gap import draw_candidate_ranking, draw_verified_trials
from tests.science.discrepancy.simulated_records import build_records, tabulate
from tests.science.plant.machines import read_plant

STEP_S, QUICK = 0.01, 5.0
WAY = 0.2 * np.sin(QUICK * STEP_S * np.arange(3000))
"""Of 0.2 m and 1 m/s at most."""


def follow(kind):
    """Return the output channel of a machine whose motion is `WAY`, nearly."""
    named = {
        "static_map": {"along": "way_m", "output": "force_n"},
        "second_order": {"input": "push_n", "output": "way_m"},
    }
    signals = {
        "static_map": {"way_m": WAY, "force_n": 30.0 * WAY},
        "second_order": {"push_n": 30.0 * WAY, "way_m": WAY},
    }
    return build_records(*tabulate(signals[kind], STEP_S), read_plant(kind, **named[kind]))


def leave(output):
    """Return what figures look at, of an output that leaves a residual of one floor."""
    fit = SimpleNamespace(residual=np.where(output.present, 1.0, 0.0))
    return SimpleNamespace(output=output, nominal=SimpleNamespace(fit=fit), floor=1.0)


@pytest.mark.parametrize(
    ("kind", "labels", "title"),
    [
        ("static_map", ("way (m)", "rate of way (m/s)"), "force, element"),
        ("second_order", ("motion (m)", "velocity (m/s)"), "way, oscillator"),
    ],
)
def test_the_plane_of_a_machine_shows_its_motion_in_metres_and_per_second(kind, labels, title):
    state = leave(follow(kind))
    figure = draw_residual_plane(average_plane([state]))
    plane, bar = figure.axes
    assert (plane.get_xlabel(), plane.get_ylabel(), plane.get_title()) == (*labels, title)
    shown = np.abs(plane.collections[0].get_offsets()).max(axis=0)
    np.testing.assert_allclose(shown, [0.2, 0.2 * QUICK], rtol=0.1)
    figure.draw_without_rendering()
    inside = figure.bbox.padded(1.0)
    words = bar.yaxis.label.get_window_extent()
    assert inside.y0 <= words.y0 < words.y1 <= inside.y1
    loop = draw_residual_loops(average_loops([state])).axes[0]
    assert loop.get_xlabel() == labels[0]


def test_a_trial_is_called_with_its_record_and_nothing_is_before_where_nothing_was_added():
    columns = {"trial": 2, "time_s": STEP_S * np.arange(50), "muscle": "motor", "channel": "speed_rad_per_s"}
    same = dict.fromkeys(("measured", "before", "after", "patched", "low", "high"), WAY[:50])
    rows = pd.DataFrame({**columns, **same})
    names = {2: "2 (record 3)"}
    for added, words in ((0.0, ["simulated", "band about it"]), (0.1, ["simulated before", "simulated after"])):
        figure = draw_verified_trials(rows.assign(after=WAY[:50] + added), "speed_rad_per_s", ["motor"], names)
        top, below = figure.axes
        assert top.get_title() == "trial 2 (record 3)"
        assert (top.get_ylabel(), below.get_ylabel()) == ("motor\nspeed (rad/s)", "motor\nresidual (rad/s)")
        legend = [each.get_text() for each in figure.legends[0].get_texts()]
        assert legend[0] == "measured"
        assert [each for each in words if each not in legend] == []


def test_the_largest_gap_of_a_ranking_is_within_the_frame():
    names = ["unknown", "none", "memory"]
    ranking = pd.DataFrame({"name": names, "probability": [0.9, 0.1, 0.0], "heldout_gap": 0.0155, "absorbed": False})
    right = draw_candidate_ranking(ranking).axes[1]
    assert right.get_xlim()[1] > 1.02 * 1.55


def test_a_proposed_trial_says_what_it_tells_apart_and_in_which_unit():
    told = {"time_s": STEP_S * np.arange(50), "muscle": "drive", "channel": "pos_m", "value": WAY[:50]}
    signals = pd.concat([pd.DataFrame({**told, "signal": name}) for name in ("force_n", "viscous_friction", "none")])
    figure = draw_proposed_trial(signals, ["viscous_friction", "none"])
    assert figure.get_suptitle() == "a trial that would tell apart: viscous friction, no further effect"
    labels = [axis.get_ylabel() for axis in figure.axes]
    assert labels == ["force (N)", "drive\npos (m)", "drive\ndifference (m)"]
