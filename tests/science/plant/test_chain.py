"""Effects along the chain of a whole machine's muscles."""

import numpy as np
import pytest

from stages.science.plant.chain import Chain
from stages.science.plant.effect import ChainEffect, find_effect, list_effects
from stages.science.plant.filters import respond
from tests.science.plant.columns import STEP_S
from tests.science.plant.machines import configured, with_effects

CHAIN = [name for name in list_effects() if name != "none" and isinstance(find_effect(name), ChainEffect)]


def entry(name, magnitude=None, place=None):
    """A list entry of an effect at its prior mean (where that is none, where a fit begins), or another magnitude."""
    first, *others = find_effect(name).parameters
    values = {each.name: each.prior_mean or each.starts[0] for each in (first, *others)}
    return {"name": name, "muscles": place, **values, **({} if magnitude is None else {first.name: magnitude})}


def chain_with(*effects):
    rig = configured()
    return Chain(rig.exoskeleton, with_effects(rig.plant, *effects))


def move(shape, amplitude=0.05):
    """Contractions of four muscles that swing out of step, and their rates."""
    turns = np.arange(4) if len(shape) == 2 else np.arange(shape[1] * 4).reshape(shape[1:])
    time = np.arange(shape[0]).reshape(-1, *[1] * (len(shape) - 1))
    contraction = 0.1 + amplitude * np.sin(time / 30 + turns)
    return contraction, np.gradient(contraction, STEP_S, axis=0)


@pytest.mark.parametrize("name", CHAIN)
def test_an_effect_changes_its_own_muscles_only(name, generator):
    command, motion = generator.uniform(20, 300, (400, 4)), move((400, 4))
    outcomes = []
    largest = 20.0 if name == "saturation" else find_effect(name).parameters[0].starts[-1]
    for chain in (chain_with(), chain_with(entry(name, largest, place=["pam2", "pam4"]))):
        pressure = chain.pressurise(command)
        force, tension = chain.pull(pressure, *motion)
        shown = chain.sense_force(tension, pressure, *motion)
        outcomes.append(np.stack([pressure, chain.sense_pressure(pressure), force, tension, shown]))
    differs = (outcomes[0] != outcomes[1]).any(axis=(0, 1))
    assert differs.tolist() == [False, True, False, True]


def test_trials_side_by_side_are_trials_one_by_one(generator):
    chain = chain_with(*(entry(name, place=["pam1", "pam4"]) for name in CHAIN))
    command, (contraction, velocity) = generator.uniform(20, 300, (300, 5, 4)), move((300, 5, 4), 0.02)
    path, flat = chain.repeat(5), (each.reshape(300, 20) for each in (command, contraction, velocity))
    pressure = path.pressurise(next(flat))
    together = path.pull(pressure, *flat)[1].reshape(300, 5, 4)
    for n in range(5):
        alone = chain.pull(chain.pressurise(command[:, n]), contraction[:, n], velocity[:, n])[1]
        assert np.array_equal(together[:, n], alone)


def test_no_effect_is_an_effect_and_the_load_cell_of_a_muscle_sees_no_cable(generator):
    pressure, motion = generator.uniform(20, 300, (400, 4)), move((400, 4))
    plain = chain_with().pull(pressure, *motion)
    assert np.array_equal(chain_with({"name": "none", "muscles": None}).pull(pressure, *motion), plain)
    force, tension = chain_with(entry("capstan_friction")).pull(pressure, *motion)
    assert np.array_equal(force, plain[0])
    assert not np.array_equal(tension, plain[1])


def test_tension_never_turns_into_push():
    everything = [entry(name, find_effect(name).parameters[0].high) for name in CHAIN]
    pressure = np.tile([30.0, 80.0, 30.0, 80.0], (6000, 1))
    force, tension = chain_with(*everything).pull(pressure, *move((6000, 4), 0.15))
    assert force.min() == tension.min() == 0.0


def test_the_rich_plant_has_effects_at_every_site_of_the_chain_and_the_nominal_one_none():
    here = {"hysteresis", "capstan_friction", "valve_asymmetry", "threshold_pressure", "coulomb_friction", "creep"}
    assert {each.name for each in configured("rich").plant.effects} >= here
    assert configured("nominal").plant.effects == []


@pytest.mark.parametrize(("rise", "fall"), [(0.04, 0.04), (0.03, 0.06), (0.0, 0.0)])
def test_a_held_command_is_answered_by_exponentials(generator, rise, fall):
    levels = generator.uniform(50, 500, 12)
    expected = [levels[0]]
    for held in levels:
        last, tau = expected[-1], max(rise if held > expected[-1] else fall, 1e-12)
        expected.extend(held + (last - held) * np.exp(-np.arange(1, 11) * STEP_S / tau))
    pressure = respond(np.repeat(levels, 10)[:, None], np.array([rise]), np.array([fall]), STEP_S)[:, 0]
    assert pressure == pytest.approx(expected[:-1], rel=1e-9)
