import numpy as np
import pytest

from stages.plant.chain import Chain
from stages.plant.effect import ChainEffect, JointEffect, find_effect, list_effects
from tests.plant.machines import configured, with_effects

CHAIN = [name for name in list_effects() if name != "none" and isinstance(find_effect(name), ChainEffect)]
AT_REST_ONE = 0.08


def entry(name, magnitude=None, place=None):
    """A list entry of an effect at its prior mean (where that is none, where a fit begins), or another magnitude."""
    effect = find_effect(name)
    values = {each.name: each.prior_mean or each.starts[0] for each in effect.parameters}
    if magnitude is not None:
        values[effect.parameters[0].name] = magnitude
    return {"name": name, "joints" if isinstance(effect, JointEffect) else "muscles": place, **values}


def chain_with(*effects):
    rig = configured()
    return Chain(rig.exoskeleton, with_effects(rig.plant, *effects))


def rub(cycles=3, amplitude=0.05, hertz=0.5, samples=6000, rate=250.0):
    """A slow sine of contraction for four muscles at constant pressure."""
    time = np.arange(samples) / rate
    phase = 2 * np.pi * hertz * time
    contraction = np.repeat((AT_REST_ONE + amplitude * np.sin(phase))[:, None], 4, axis=1)
    velocity = np.repeat((amplitude * 2 * np.pi * hertz * np.cos(phase))[:, None], 4, axis=1)
    pressure = np.full((samples, 4), 1.0) * [150.0, 400.0, 150.0, 400.0]
    return pressure, contraction, velocity


def work_of_last_cycle(force, contraction, period):
    """Work done on the outside, N: positive would be energy from nothing."""
    f, c = force[-period - 1 :, 0], contraction[-period - 1 :, 0]
    return float(np.sum(0.5 * (f[1:] + f[:-1]) * np.diff(c)))


@pytest.mark.parametrize("name", CHAIN)
def test_an_effect_changes_its_own_muscles_only(name, generator):
    command = generator.uniform(20, 300, (400, 4))
    contraction = 0.1 + 0.05 * np.sin(np.arange(400)[:, None] / 30 + np.arange(4))
    velocity = np.gradient(contraction, 0.004, axis=0)
    outcomes = []
    largest = 20.0 if name == "saturation" else find_effect(name).parameters[0].starts[-1]
    for chain in (chain_with(), chain_with(entry(name, largest, place=["pam2", "pam4"]))):
        pressure = chain.pressurise(command)
        force, tension = chain.pull(pressure, contraction, velocity)
        shown = chain.sense_force(tension, pressure, contraction, velocity)
        outcomes.append(np.stack([pressure, chain.sense_pressure(pressure), force, tension, shown]))
    differs = (outcomes[0] != outcomes[1]).any(axis=(0, 1))
    assert differs.tolist() == [False, True, False, True]


def test_trials_side_by_side_are_trials_one_by_one(generator):
    chain = chain_with(*(entry(name, place=["pam1", "pam4"]) for name in CHAIN))
    command = generator.uniform(20, 300, (300, 5, 4))
    contraction = 0.1 + 0.02 * np.sin(np.arange(300)[:, None, None] / 30 + generator.uniform(0, 6, (5, 4)))
    velocity = np.gradient(contraction, 0.004, axis=0)
    together = chain.pull(chain.pressurise(command), contraction, velocity)[1]
    for n in range(5):
        alone = chain.pull(chain.pressurise(command[:, n]), contraction[:, n], velocity[:, n])[1]
        assert np.array_equal(together[:, n], alone)


@pytest.mark.parametrize("name", ["hysteresis", "creep", "capstan_friction"])
def test_loops_dissipate(name):
    pressure, contraction, velocity = rub()
    still = np.zeros_like(velocity)
    textbook = chain_with().pull(pressure, contraction, still)[1]
    tension = chain_with(entry(name)).pull(pressure, contraction, velocity)[1]
    damped = chain_with().pull(pressure, contraction, velocity)[1]
    assert work_of_last_cycle(textbook, contraction, 500) == pytest.approx(0.0, abs=1e-6)
    assert work_of_last_cycle(tension, contraction, 500) < 1.2 * work_of_last_cycle(damped, contraction, 500) < 0.0


def test_hysteresis_does_not_depend_on_speed_and_grows_with_pressure():
    chain, plain = chain_with(entry("hysteresis")), chain_with()

    def loop(hertz, factor):
        pressure, contraction, velocity = rub(hertz=hertz)
        args = (factor * pressure, contraction, np.zeros_like(velocity))
        period = round(250 / hertz)
        return work_of_last_cycle(chain.pull(*args)[0] - plain.pull(*args)[0], contraction, period)

    assert loop(1.0, 1.0) == pytest.approx(loop(0.5, 1.0), rel=0.01)
    assert loop(0.5, 2.0) == pytest.approx(2 * loop(0.5, 1.0), rel=1e-9)


def test_cable_friction_is_the_capstan_equation():
    pressure, contraction, velocity = rub()
    friction = entry("capstan_friction", 0.2) | {"sliding_per_s": 0.001}
    force, tension = chain_with(friction).pull(pressure, contraction, velocity)
    sliding = np.abs(velocity[:, 0]) > 0.02
    ratio = (tension / force)[sliding, 0]
    assert ratio == pytest.approx(np.exp(-0.2 * np.sign(velocity[sliding, 0])), rel=1e-6)
    assert np.array_equal(force, chain_with().pull(pressure, contraction, velocity)[0])


def test_threshold_pressure_is_missing_from_the_force():
    pressure = np.linspace(-1.0, 300.0, 200)[:, None] * np.ones(4)
    contraction = np.full((200, 4), 0.05)
    shifted = chain_with().pull(np.maximum(pressure - 30.0, np.minimum(pressure, 0.0)), contraction, 0 * contraction)[0]
    assert chain_with(entry("threshold_pressure", 30.0)).pull(pressure, contraction, 0 * contraction)[
        0
    ] == pytest.approx(shifted)


@pytest.mark.parametrize("asymmetry", [-0.3, 0.5])
def test_asymmetry_is_two_time_constants(asymmetry):
    up = np.where(np.arange(300)[:, None] < 10, 100.0, 200.0) * np.ones(4)
    chain = chain_with(entry("valve_asymmetry", asymmetry))
    tau = configured().plant.muscles["MAS-40"].valve_tau_s
    since = np.arange(290) * 0.004
    rising = chain.pressurise(up)[10:, 0]
    falling = chain.pressurise(300.0 - up)[10:, 0]
    assert rising == pytest.approx(200 - 100 * np.exp(-since * (1 + asymmetry) / tau), rel=1e-9)
    assert falling == pytest.approx(100 + 100 * np.exp(-since / (1 + asymmetry) / tau), rel=1e-9)


@pytest.mark.parametrize("delay", [0.004, 0.010])
def test_delay_moves_a_ramp(delay):
    ramp = np.arange(300.0)[:, None] * np.ones(4)
    late = chain_with(entry("transport_delay", delay)).pressurise(ramp)
    gap = (chain_with().pressurise(ramp) - late)[-1]
    assert gap == pytest.approx(delay / 0.004, rel=1e-9)


def test_no_effect_is_an_effect(generator):
    pressure, contraction, velocity = rub()
    none = {"name": "none", "muscles": None}
    assert np.array_equal(
        chain_with(none).pull(pressure, contraction, velocity), chain_with().pull(pressure, contraction, velocity)
    )


def test_tension_never_turns_into_push():
    pressure, contraction, velocity = rub(amplitude=0.15)
    everything = [entry(name, find_effect(name).parameters[0].high) for name in CHAIN]
    force, tension = chain_with(*everything).pull(0.2 * pressure, contraction, velocity)
    assert force.min() == 0.0
    assert tension.min() == 0.0


def test_the_rich_plant_has_effects_at_every_site_of_the_chain():
    used = {each.name for each in configured("rich").plant.effects}
    assert used >= {
        "hysteresis",
        "capstan_friction",
        "valve_asymmetry",
        "threshold_pressure",
        "coulomb_friction",
        "creep",
    }
    assert configured("nominal").plant.effects == []
