"""Whatever stands at a key of the configuration, it is accepted or refused by one line that names the key."""

import copy
import functools
import json
import tempfile
from pathlib import Path

import pytest
from hypothesis import HealthCheck, Phase, assume, given, settings
from hypothesis import strategies as st
from omegaconf import OmegaConf

from pipeline.config import read_study
from pipeline.errors import ConfigError
from tests.composing import compose_values
from tests.conftest import Command

REMOVED, ADDED = object(), object()
WHOLE = [-1, 0, 1, 2, 3, 35, 999, 10**30]
BROKEN = [-1.0, 0.0, 1e-300, 1e-9, 0.001, 0.3, 1.0, 100.0, 1e9, 1e300, float("nan"), float("inf"), float("-inf")]
TEXTS = ["", " ", "1", "word", "two\nlines"]
OTHERS = [None, True, *WHOLE, *BROKEN, *TEXTS, [], ["word"], [1, 2], {}, {"word": 1}, REMOVED, ADDED]
NAMED_BY_THE_SECTION_THAT_IT_LISTS = {("workflow", "quoted")}


PLAIN = OmegaConf.to_container(compose_values())
"""The default configuration as plain values, its interpolations as they are written."""
COMPOSED = OmegaConf.create(PLAIN)


def find_leaves(node, path=()):
    """Yield the path of every value that is no section and no list of sections."""
    if isinstance(node, dict) and node:
        for key, value in node.items():
            yield from find_leaves(value, (*path, key))
    elif isinstance(node, list) and node and isinstance(node[0], dict):
        for index, value in enumerate(node):
            yield from find_leaves(value, (*path, index))
    elif path not in NAMED_BY_THE_SECTION_THAT_IT_LISTS:
        yield path


def changed(path, other):
    """The configuration with one key changed, and the key."""
    *above, last = path
    values = PLAIN | {path[0]: copy.deepcopy(PLAIN[path[0]])}
    node = functools.reduce(lambda each, part: each[part], above, values)
    if other is REMOVED:
        del node[last]
    else:
        last, other = (f"{last}_more", 1) if other is ADDED else (last, other)
        node[last] = other
    whole = copy.copy(COMPOSED)  # of which the sections stay the same
    for key in {path[0], last} if len(path) == 1 else {path[0]}:
        whole.pop(key, None)
        if key in values:
            whole[key] = values[key]
    return whole, last


def check(path, other):
    """Accept, or be refused properly."""
    values, key = changed(path, other)
    try:
        read_study(values)
    except ConfigError as refusal:
        text = str(refusal)
        assert len(text.splitlines()) == 1
        row = "joint" if path[:2] == ("exoskeleton", "joints") else "muscle"
        assert str(key) in text or (key == "name" and row in text)


LEAVES = list(find_leaves(PLAIN))


@given(st.sampled_from(LEAVES), st.sampled_from(OTHERS))
@settings(derandomize=True, deadline=None, max_examples=120)
def test_any_value_is_accepted_or_refused_by_a_line_that_names_its_key(path, other):
    check(path, other)


UTILITIES = ["y_y", "f_f", "f_y", "y_y_theta", "log_det", "variance", "predictive_information", "random"]
UTILITIES.append("hyperparameter_information")
DURATIONS = ["{low: 0.0,high: 0.0}", "{low: 0.0,high: 0.01}", "{low: 0.004,high: 0.3}", "{low: 3600.0,high: 3600.0}"]
SMALL = {
    "bank.seed": st.integers(0, 2**40),
    "bank.trajectories": st.integers(2, 5),
    "bank.pressure.hold_s": st.sampled_from(DURATIONS),
    "bank.pressure.transition_s": st.sampled_from(DURATIONS),
    "bank.pressure.step_share": st.sampled_from([0.0, 0.5, 1.0]),
    "bank.pressure.range_kpa.pam2.low": st.sampled_from([0.0, 600.0]),
    "subsampling.every": st.sampled_from([1, 7, 60]),
    "subsampling.experiments": st.integers(1, 2),
    "subsampling.initial_trials": st.integers(1, 2),
    "active_loop.utility": st.sampled_from(UTILITIES),
    "active_loop.controls": st.none() | st.lists(st.sampled_from(UTILITIES), max_size=2, unique=True),
    "active_loop.subsample_utility": st.sampled_from([name for name in UTILITIES if name != "log_det"]),
    "active_loop.trials": st.integers(1, 3),
    "active_loop.initial_points": st.sampled_from([1, 2, 10, 60]),
    "active_loop.points_per_trial": st.sampled_from([1, 2, 20]),
    "active_loop.reduce": st.sampled_from(["sum", "max"]),
    "active_loop.reuse_trajectories": st.booleans(),
    "active_loop.joint_every": st.sampled_from([1, 2, 10]),
    "active_loop.starts": st.integers(0, 2),
    "active_loop.memory_mb": st.sampled_from([1e-6, 64.0, 1e6]),
    "exoskeleton.trial_s": st.sampled_from([0.25, 0.3, 1.0]),
    "exoskeleton.velocity_filter.window_s": st.sampled_from([0.02, 0.05, 0.24]),
    "exoskeleton.velocity_filter.order": st.integers(1, 3),
}


def type_override(key, value):
    """Return what a person types to set a key."""
    return f"{key}={value if isinstance(value, str) else json.dumps(value)}"


def is_accepted(overrides):
    try:
        read_study(compose_values(*overrides))
    except ConfigError:
        return False
    return True


@pytest.mark.slow
@given(st.fixed_dictionaries(SMALL))
@settings(
    derandomize=True,
    deadline=None,
    max_examples=5,
    phases=[Phase.generate],
    suppress_health_check=[HealthCheck.filter_too_much, HealthCheck.too_slow],
)
def test_what_is_accepted_runs_to_the_end(values):
    overrides = ["budget=tiny", "figures=[png]", *(type_override(key, value) for key, value in values.items())]
    assume(is_accepted(overrides))
    with tempfile.TemporaryDirectory() as folder:
        result = Command(Path(folder) / "outputs", *overrides)()
    assert result.returncode == 0, result.stderr
    assert result.stderr == ""
