"""Simulations: muscles against a NumPy loop over time that takes all columns at once; machines against themselves."""

import numpy as np
import pytest
import yaml

from stages.science.plant.chain import Chain
from stages.science.plant.effect import find_effect
from stages.science.plant.machine import read_machine
from tests.science.plant.machines import CONF, configured

SAMPLES, TRIALS, MUSCLES = 1000, 20, 4


def test_chain_against_a_numpy_loop(against, tell):
    rig = configured()
    chain = Chain(rig.exoskeleton, rig.plant)
    constants = chain.constants
    generator = np.random.default_rng(20261121)
    shape = (SAMPLES, TRIALS, MUSCLES)
    command = generator.uniform(20, 300, shape)
    contraction, velocity = generator.uniform(0.0, 0.2, shape), 0.1 * generator.standard_normal(shape)

    def loop():
        pressure, force = np.empty(shape), np.empty(shape)
        now, decay = command[0].copy(), np.exp(-chain.step_s / constants.valve_tau_s)
        for k in range(SAMPLES):
            pressure[k] = now
            braid = constants.braid_a * (1.0 - constants.contraction_factor * contraction[k]) ** 2 - constants.braid_b
            rubber = contraction[k] * (constants.passive_linear_n + constants.passive_quadratic_n * contraction[k])
            pull = now * constants.area_n_per_kpa * braid - rubber - constants.damping_n_s * velocity[k]
            force[k] = np.maximum(pull, 0.0)
            now = command[k] + decay * (now - command[k])
        return pressure, force

    def compiled():
        path = chain.repeat(TRIALS)
        pressure = path.pressurise(command.reshape(SAMPLES, -1))
        force = path.pull(pressure, *(each.reshape(SAMPLES, -1) for each in (contraction, velocity)))[0]
        return pressure.reshape(shape), force.reshape(shape)

    difference = max(
        float(np.abs(mine - theirs).max() / np.abs(theirs).max())
        for mine, theirs in zip(compiled(), loop(), strict=True)
    )
    tell("simulation: largest difference from the loop", difference, "", 1e-12)
    assert difference <= 1e-12
    tell("simulation / NumPy loop", against(compiled, loop, 50), "", 1 / 30)


def test_whole_trial_in_real_time(benchmark, sized, tell):
    """A trial with joints, person, effects and their feedback: how much quicker than it would last."""
    rig = configured("rich")
    from stages.science.rig.trial import Trial

    command = np.full((rig.samples, len(rig.muscles)), 100.0)
    trial = Trial("free", "experimenter", command)

    def execute():
        with rig:
            rig.execute(trial, np.random.default_rng(0))

    execute()
    benchmark.pedantic(execute, rounds=sized(10))
    seconds = benchmark.stats.stats.median
    tell("simulated trial (rich plant) / its duration", seconds / (rig.samples / rig.sampling_rate_hz))


@pytest.mark.parametrize("rubbing", [False, True], ids=["linear", "slider"])
def test_constants_side_by_side_against_one_after_the_other(rubbing, against, tell):
    """Eight cases of an oscillator, as the derivatives of a fit take them; what comes out is the same, bit for bit."""
    told = yaml.safe_load((CONF / "plant" / "second_order.yaml").read_text())
    plant = read_machine({**told, "output_scale": 1.0, "time_scale_s": 0.16})
    generator = np.random.default_rng(20261121)
    signals = plant.refine({"drive_v": np.cumsum(generator.standard_normal((20000, 1)), axis=0) / 20.0}, 0.02)
    known = {"static_gain": 1.0, "damping_ratio": 0.1, "input_offset": 0.0, "output_offset": 0.0, "input_delay_s": 0.0}
    effects = [(find_effect("coulomb_friction", "slider"), {"share": 0.1, "sliding": 0.05})] if rubbing else []
    cases = [({**known, "natural_frequency_hz": 1.0 + 0.01 * place}, effects) for place in range(8)]

    def together():
        return plant.simulate_each(signals, 0.02, np.zeros(1), cases)

    def apart():
        return np.stack([plant.simulate(signals, 0.02, np.zeros(1), *case) for case in cases], axis=2)

    np.testing.assert_array_equal(together(), apart())
    name = "with dry friction" if rubbing else "linear"
    tell(f"8 motions side by side / one after the other, {name}", against(together, apart, 20), "", 0.6)
