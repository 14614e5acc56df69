"""What holds for every form of every effect."""

import importlib
import re
from dataclasses import replace
from types import SimpleNamespace
from typing import get_args

import numpy as np
import pytest

from stages.science.plant.actuator_path import Acting, ActuatorPath, predict_force, predict_pressure
from stages.science.plant.chain import Chain
from stages.science.plant.effect import ChainEffect, JointEffect, Site, find_effect, list_effects, list_forms
from stages.science.plant.machine import list_kinds
from stages.science.plant.muscle import MuscleConstants
from stages.science.plant.plant import Plant
from stages.science.rig.sim import SimulatedRig
from stages.science.rig.trial import Trial
from tests.science.plant.columns import CHAIN_FORMS, STEP_S, begin, constants, label, predict, rough, with_magnitude
from tests.science.plant.machines import CONF, configured, with_effects

ALL = [effect for name in list_effects() for effect in list_forms(name)]
MACHINES = [importlib.import_module(f"stages.science.plant.machines.{kind}").PLANT for kind in list_kinds()]
SITES = {*get_args(Site), *(machine.SITE for machine in MACHINES)}
STEPPED = ("quantisation",)
START_S = np.array([0.0, 50.0, 300.0])

every_form = pytest.mark.parametrize("effect", CHAIN_FORMS, ids=label)


def both(effect, parameters, signals, **where):
    return np.stack(predict(signals, [(effect, parameters)], **where))


@pytest.mark.parametrize("effect", ALL, ids=label)
def test_a_form_declares_itself_and_parameters_that_begin_and_are_expected_within_their_bounds(effect):
    module = importlib.import_module(f"stages.science.effects.{effect.name}")
    assert module.EFFECT is find_effect(effect.name)
    assert len(module.__doc__) > 60
    assert find_effect(effect.name, effect.form) is effect
    assert effect in list_forms(effect.name)
    assert effect.site in SITES
    assert effect.split_by
    assert effect.signature[-1] != "."
    assert effect.source == "nothing" or re.search(r"\((19|20)\d\d\)", effect.source)
    for parameter in effect.parameters:
        assert parameter.description
        assert parameter.low < parameter.high
        assert parameter.low <= parameter.prior_mean <= parameter.high
        assert 0.0 < parameter.prior_sd <= parameter.high - parameter.low
        assert 1 <= len(parameter.starts) <= (3 if getattr(effect, "scales", True) else 6)
        assert all(parameter.low < start < parameter.high for start in parameter.starts)
        unit = parameter.unit.replace("N m", "nm").replace("/", "_per_").removeprefix("1_").lower()
        assert parameter.unit == "1" or parameter.name.endswith(unit) or f"{unit}_" in parameter.name
    if effect.parameters:
        magnitude = effect.parameters[0]
        assert magnitude.low <= 0.0 < magnitude.high
        assert 0.0 not in magnitude.starts


GOOD = find_effect("viscous_friction", "pressure_scaled")


def with_parameter(**changed):
    return replace(GOOD, parameters=(replace(GOOD.parameters[0], **changed),))


def change_in_place(signal, state, parameters):
    signal *= 1.0 - parameters["share"]
    return signal


@pytest.mark.parametrize(
    ("effect", "told"),
    [
        (replace(GOOD, name="other"), "expected the name of its module, made_up, got other"),
        (replace(GOOD, name="made_up", site="musle"), "expected a site of command, valve, .*, got musle"),
        (replace(GOOD, name="made_up", signal="forc_n"), "expected a signal of .*, got forc_n"),
        (replace(GOOD, name="made_up", parameters=()), "expected parameters, the magnitude first, got none"),
        (with_parameter(low=0.9, high=0.0), "share: expected bounds with low below high, got 0.9 and 0"),
        (with_parameter(prior_sd=0.0), "share: expected a prior_sd above 0, got 0"),
        (with_parameter(starts=()), "share: expected starts, a tuple of numbers such as"),
        (with_parameter(starts=0.1), "share: expected starts, a tuple of numbers such as"),
        (with_parameter(starts=(0.9,)), "share: expected starts from 0 to 0.5, got"),
        (with_parameter(starts=(0.0,)), "share: expected no start at 0"),
        (replace(GOOD, apply=lambda signal, state, parameters: signal[:-1]), "expected an array of the signal's shape"),
        (replace(GOOD, apply=lambda signal, state, parameters: 1.0), "expected an array of the signal's shape"),
        (replace(GOOD, apply=lambda signal, state, parameters: signal * np.nan), "expected finite values"),
        (replace(GOOD, apply=lambda signal, state, parameters: signal + 1.0), "expected no change at magnitude 0"),
        (replace(GOOD, apply=lambda signal, state, parameters: signal * parameters["shar"]), "KeyError: 'shar'"),
        (replace(GOOD, apply=change_in_place), "expected a new array, got the signal changed in place at share 0.02"),
    ],
)
def test_a_fault_in_an_effect_of_ones_own_is_told_when_it_is_loaded(effect, told, monkeypatch):
    effect = effect if effect.name == "other" else replace(effect, name="made_up")
    monkeypatch.setattr("stages.science.plant.effect.list_effects", lambda: ("made_up",))
    monkeypatch.setattr("importlib.import_module", lambda name: SimpleNamespace(EFFECT=effect))
    with pytest.raises(ValueError, match=f"^effect made_up, form pressure_scaled: .*{told}"):
        list_forms.__wrapped__("made_up")


def test_an_effect_that_cannot_be_loaded_is_told_with_its_file(monkeypatch):
    monkeypatch.setattr("stages.science.plant.effect.list_effects", lambda: ("made_up",))
    with pytest.raises(
        ValueError, match=r"^effect made_up: .*/effects/made_up\.py cannot be loaded: ModuleNotFoundError"
    ):
        list_forms.__wrapped__("made_up")


@every_form
def test_the_effect_fades_with_its_magnitude_and_zero_is_the_textbook_to_the_bit(effect, generator):
    signals = rough(generator)
    plain = np.stack(predict(signals, [], start_s=START_S))
    for shape in ({}, {p.name: p.starts[-1] for p in effect.parameters[1:]}):
        absent = both(effect, with_magnitude(effect, 0.0) | shape, signals, start_s=START_S)
        assert absent.tobytes() == plain.tobytes()
    begun = begin(effect)[effect.parameters[0].name]
    sizes = [np.abs(both(effect, with_magnitude(effect, m), signals) - plain).max() for m in (1e-6, 1e-4, begun)]
    assert sizes[0] <= 0.02 * sizes[1] + 1e-6
    assert sizes[1] <= 0.25 * sizes[2]


@every_form
def test_an_effect_does_something_where_it_acts(effect, generator):
    signals = rough(generator)
    largest = with_magnitude(effect, effect.parameters[0].starts[-1])
    pressure, force = both(effect, largest, signals, start_s=START_S) - np.stack(predict(signals, []))
    if effect.signal in ("pressure_command_kpa", "pressure_kpa"):
        assert not force.any()
    if effect.signal in ("pressure_command_kpa", "pressure_kpa", "sensed_pressure_kpa"):
        assert np.abs(pressure).max() > 0.1
    else:
        assert np.abs(force).max() > 1.0
        assert not pressure.any()


@every_form
@pytest.mark.parametrize("muscle", ["pam1", "pam2"])
def test_whatever_the_bounds_allow_is_finite(effect, generator, muscle):
    signals = rough(generator)
    corners = [{p.name: getattr(p, end) for p in effect.parameters} for end in ("low", "high")]
    magnitude, *rest = effect.parameters
    corners.append({magnitude.name: magnitude.high} | {p.name: p.low for p in rest})
    for parameters in corners:
        assert np.isfinite(both(effect, parameters, signals, muscle=muscle)).all()


@every_form
def test_the_effect_is_continuous_in_every_parameter(effect, generator):
    if effect.name in STEPPED:
        pytest.skip("counts jump; that they never err by more than half of one is tested beside their physics")
    signals = rough(generator)
    for parameter in effect.parameters:
        at = begin(effect)[parameter.name]
        changes = []
        for step in (1e-3, 1e-5):
            nearby = begin(effect, **{parameter.name: at * (1.0 + step)})
            changed, as_begun = (both(effect, each, signals, start_s=START_S) for each in (nearby, begin(effect)))
            changes.append(np.abs(changed - as_begun).max())
        assert changes[1] <= 0.02 * changes[0] + 1e-9
        assert changes[0] < 50.0


@every_form
def test_columns_do_not_know_each_other(effect, generator):
    signals = rough(generator)
    together = both(effect, begin(effect), signals, start_s=START_S)
    for column in range(3):
        one = [each[:, column : column + 1] for each in signals]
        alone = both(effect, begin(effect), one, start_s=START_S[column : column + 1])
        assert np.array_equal(together[:, :, column : column + 1], alone)


def test_the_place_chooses_the_form():
    at_joint = {"torque_nm": 1.0, "sliding_rad_per_s": 0.1}
    in_cable = {"share": 0.02, "sliding_per_s": 0.01}
    plant = with_effects(
        configured().plant,
        {"name": "coulomb_friction", "joints": None, **at_joint},
        {"name": "coulomb_friction", "muscles": ["pam2"], **in_cable},
    )
    assert [each.form for each in plant.effects] == ["joint_torque", "cable"]
    assert isinstance(plant.effects[0].effect, JointEffect)
    assert [list(each)[:2] for each in plant.model_dump()["effects"]] == [["name", "joints"], ["name", "muscles"]]


@every_form
def test_a_plants_list_brings_the_form_back_and_a_chain_of_it_shows_what_a_fit_sees(effect, generator):
    rig, start = configured(), np.full(4, 120.0)
    command, pressure, contraction, velocity = rough(generator, columns=4)
    parameters = begin(effect)
    plant = with_effects(rig.plant, {"name": effect.name, "form": effect.form, "muscles": None, **parameters})
    assert plant.effects[0].effect is effect
    written = plant.model_dump()
    assert Plant.model_validate(written) == plant
    usual = next(each for each in list_forms(effect.name) if isinstance(each, ChainEffect))
    assert ("form" in written["effects"][0]) == (effect is not usual)

    chain = Chain(rig.exoskeleton, plant, start_s=120.0)
    fitted = predict_pressure(command, chain.constants, [(effect, parameters)], STEP_S, start)
    assert np.array_equal(chain.sense_pressure(chain.pressurise(command)), fitted)
    tension = chain.pull(pressure, contraction, velocity)[1]
    shown = chain.sense_force(tension, pressure, contraction, velocity)
    chosen = [] if effect.signal == "sensed_pressure_kpa" else [(effect, parameters)]
    fitted = predict_force(pressure, contraction, velocity, chain.constants, chosen, STEP_S, start, "joint_end")
    assert np.array_equal(shown, fitted)


def test_constants_of_the_fit_do_what_they_say(generator):
    command, pressure, contraction, velocity = rough(generator)
    row, start = constants(3), np.zeros(3)

    def press(**changed):
        return predict_pressure(command, constants(3, **changed), [], STEP_S, start)

    def pull(changed: MuscleConstants):
        return predict_force(pressure, contraction, 0 * velocity, changed, [], STEP_S, start, "muscle_tip")

    assert press(regulator_gain=1.1, regulator_offset_kpa=5.0) == pytest.approx(1.1 * press() + 5.0)
    assert pull(constants(3, force_offset_n=-20.0)) == pytest.approx(pull(row) - 20.0)
    bare = {"passive_linear_n": 0.0}
    assert pull(constants(3, area_factor=1.2, **bare)) == pytest.approx(1.2 * pull(constants(3, **bare)))


@pytest.mark.parametrize("form", ["offset-pressure", "drift-pressure_linear", "gain-pressure"])
def test_a_sensors_error_in_pressure_is_taken_back_before_force(form, generator):
    _, pressure, contraction, velocity = rough(generator)
    row, start = constants(3), np.array([0.0, 100.0, 400.0])
    effect = find_effect(*f"sensor_{form}".split("-"))
    shown = ActuatorPath(row, [Acting(effect, begin(effect))], STEP_S, start).sense_pressure(pressure)
    true, again = (
        predict_force(kpa, contraction, velocity, row, entry, STEP_S, start, "muscle_tip")
        for kpa, entry in ((pressure, []), (shown, [(effect, begin(effect))]))
    )
    assert again == pytest.approx(true, abs=0.6 if form == "gain-pressure" else 6e-6)
    assert np.abs(shown - pressure).max() > 1.0


def test_a_simulated_rig_records_through_its_sensors():
    rig = configured()
    trial = Trial("free", "experimenter", np.full((rig.samples, 4), 100.0))

    def force_with(*effects):
        values = rig.model_dump() | {"plant": with_effects(rig.plant, *effects).model_dump()}
        with SimulatedRig.model_validate(values) as changed:
            return changed.execute(trial, np.random.default_rng(3)).force_n

    plain = force_with()
    ratio = 6000.0 / np.quantile(plain[:, 0], 0.5)
    clip = {"name": "saturation", "muscles": ["pam1"], "full_force_over_level": float(ratio)}
    clipped = force_with(clip)
    assert clipped[:, 0] == pytest.approx(np.minimum(plain[:, 0], clipped[:, 0].max()))
    assert (clipped[:, 0] == clipped[:, 0].max()).mean() == pytest.approx(0.5, abs=0.05)
    assert np.array_equal(clipped[:, 1:], plain[:, 1:])


def test_every_form_has_its_own_name_in_the_documentation():
    assert len({label(effect) for effect in ALL}) == len(ALL)
    page = (CONF.parent / "docs" / "plant.md").read_text()
    rows = {match[1]: line for line in page.splitlines() if (match := re.match(r"\| `(\w+)` \|", line))}
    assert [name for name in list_effects() if name not in rows] == []
    for effect in ALL:
        assert f"`{effect.form}`" in rows[effect.name]
        assert all(f"`{parameter.name}`" in rows[effect.name] for parameter in effect.parameters)
