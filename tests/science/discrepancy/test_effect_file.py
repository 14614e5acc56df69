"""An effect that is written from a formula is a module of the library, and does what the formula says."""

import subprocess
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from ruff import find_ruff_bin

from stages.science.discrepancy.description import describe
from stages.science.discrepancy.effect_file import choose_formula, write_effect
from stages.science.discrepancy.resampling import resample
from stages.science.discrepancy.symbolic_regression import Sketch
from stages.science.output_channels.fitting import Model, fit
from stages.science.output_channels.noise import make_plain
from stages.science.output_channels.output_channel import Driver
from stages.science.plant.effect import ChainEffect, ElementEffect
from stages.science.signals.histories import recall
from tests.science.discrepancy.searches import DESCRIPTION
from tests.science.discrepancy.simulated_records import move
from tests.science.output_channels.test_whole_record_channel import build
from tests.science.plant.columns import STEP_S, predict, rough
from tests.science.plant.machines import read_plant

RECORD_STEP_S = 0.02
ROOT = Path(__file__).resolve().parents[3]


def load(text):
    """Return the one effect of a file, run as the library runs it, once lint finds nothing in it."""
    for check in (["check"], ["format", "--check"]):
        command = [find_ruff_bin(), *check, "--config", str(ROOT / "pyproject.toml"), "--stdin-filename", "own.py", "-"]
        checked = subprocess.run(command, input=text, capture_output=True, text=True)
        assert checked.returncode == 0, checked.stdout + checked.stderr
    module = {}
    exec(compile(text, "own.py", "exec"), module)
    (effect,) = module["FORMS"]
    return effect, {each.name: each.starts[0] for each in effect.parameters}


def found_by_hand(channel, terms, code, sizes, *inputs):
    """What is left of a muscle's channel, with a formula of inputs."""
    sketch = Sketch(tuple(terms), np.ones(3), np.zeros(3), tuple(code), tuple(sizes))
    output = SimpleNamespace(channel=channel, element="pam1", unit="N" if channel == "force_n" else "kPa")
    dependence = SimpleNamespace(inputs=[Driver(name, np.zeros((2, 3))) for name in inputs])
    return SimpleNamespace(sketch=sketch, output=output, dependence=dependence)


def describe_bend(added):
    """What is left of a spring along which something is added, N, and the spring."""
    output = build(added)
    model = Model(output)
    fitted = fit(model, make_plain(0.05), model.start)
    weights = resample(output.trials, 200, np.random.default_rng(0))
    return describe(fitted, 0.05, DESCRIPTION, weights, 0.95, np.random.default_rng(0)), output


def test_an_element_s_effect_adds_what_was_found_and_is_none_at_zero():
    way = move(1, 4800)
    rate = np.gradient(way, RECORD_STEP_S)
    added = 0.8 * np.tanh(rate / (0.1 * rate.std())) * (way / way.std())
    described, output = describe_bend(added)
    assert choose_formula([described]) is described
    effect, starts = load(write_effect("my_bend", described, output.plant))
    assert isinstance(effect, ElementEffect)
    assert (effect.name, effect.site, effect.form) == ("my_bend", "element", "formula")
    assert all(each.low < each.starts[0] < each.high for each in effect.parameters)
    values = {each.name: each.prior_mean for each in output.constants}
    signals = output.plant.refine({"position_m": way[:, None], "force_n": way[:, None]}, RECORD_STEP_S)

    def simulate(**changed):
        return output.plant.simulate(signals, RECORD_STEP_S, np.zeros(1), values, [(effect, starts | changed)])[:, 0]

    nothing = output.plant.simulate(signals, RECORD_STEP_S, np.zeros(1), values)[:, 0]
    np.testing.assert_array_equal(simulate(share=0.0), nothing)
    line = np.vander(way, 2)
    left = added - (simulate() - nothing)
    left -= line @ np.linalg.lstsq(line, left, rcond=None)[0]  # which the spring's own constants are
    assert np.sqrt(np.mean(left**2)) < 0.25 * added.std()


def test_a_muscle_s_effect_is_of_its_signals_and_their_past(generator):
    command, pressure, contraction, velocity = rough(generator)
    terms = [("[recent pressure]^2", 2e-3), ("velocity*|velocity|", -40.0)]
    code = ["x[0] * x[0]", "x[1] * np.abs(x[1])"]
    found = found_by_hand("force_n", terms, code, [1.5e4, 0.25], "recent pressure_kpa", "contraction_velocity_per_s")
    effect, starts = load(write_effect("my_force", found, SimpleNamespace()))
    assert isinstance(effect, ChainEffect)
    assert (effect.site, effect.signal, effect.parameters[0].unit) == ("muscle", "force_n", "N")
    signals = command, pressure + 200.0, contraction, velocity
    plain, with_it = (predict(signals, effects)[1] for effects in ([], [(effect, starts)]))
    late = recall(pressure + 200.0, STEP_S)
    added = 2e-3 * late**2 - 40.0 * velocity * np.abs(velocity)
    seen = (plain > 0.0) & (with_it > 0.0)
    assert seen.mean() > 0.5
    np.testing.assert_allclose((with_it - plain)[seen], added[seen], rtol=1e-6, atol=1e-6)


def test_a_pressure_s_effect_is_of_the_command():
    found = found_by_hand("pressure_kpa", [("command", 0.05)], ["x[0]"], [150.0], "pressure_command_kpa")
    effect, starts = load(write_effect("my_pressure", found, SimpleNamespace()))
    signals = rough(np.random.default_rng(3))
    plain, with_it = (predict(signals, effects)[0] for effects in ([], [(effect, starts)]))
    np.testing.assert_allclose(with_it - plain, 0.05 * signals[0], atol=1e-9)


@pytest.mark.parametrize(
    ("plant", "inputs", "code", "told"),
    [
        (
            SimpleNamespace(),
            ["pam2 pressure_kpa"],
            ["x[0]"],
            "is of pam2 pressure, which effects do not see there; they",
        ),
        (read_plant("second_order"), ["motion"], ["x[0]"], "terms of its equation of motion"),
        (SimpleNamespace(), ["pressure_kpa"], [""], "terms of its equation of motion"),
    ],
)
def test_what_no_effect_can_see_is_refused_in_a_line(plant, inputs, code, told):
    found = found_by_hand("force_n", [("a", 1.0)], code, [1.0], *inputs)
    with pytest.raises(ValueError, match=told):
        write_effect("mine", found, plant)


def test_without_a_confirmed_formula_there_is_none():
    described, _ = describe_bend(0.0)
    assert choose_formula([described]) is None
    assert choose_formula([]) is None
