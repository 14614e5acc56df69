import time

import numpy as np

from stages.plant.chain import Chain
from tests.plant.machines import configured


def test_twenty_trials_take_a_thirtieth_of_a_numpy_loop(generator):
    rig = configured()
    chain = Chain(rig.exoskeleton, rig.plant)
    constants = chain.constants
    shape = (1000, 20, 4)
    command = generator.uniform(20, 300, shape)
    contraction, velocity = generator.uniform(0.0, 0.2, shape), 0.1 * generator.standard_normal(shape)

    def loop():
        pressure, force = np.empty(shape), np.empty(shape)
        now, decay = command[0].copy(), np.exp(-chain.step_s / constants.valve_tau_s)
        for k in range(shape[0]):
            pressure[k] = now
            braid = constants.braid_a * (1.0 - constants.contraction_factor * contraction[k]) ** 2 - constants.braid_b
            rubber = contraction[k] * (constants.passive_linear_n + constants.passive_quadratic_n * contraction[k])
            pull = now * constants.area_n_per_kpa * braid - rubber - constants.damping_n_s * velocity[k]
            force[k] = np.maximum(pull, 0.0)
            now = command[k] + decay * (now - command[k])
        return pressure, force

    def compiled():
        pressure = chain.pressurise(command)
        return pressure, chain.pull(pressure, contraction, velocity)[0]

    for mine, theirs in zip(compiled(), loop(), strict=True):
        assert np.abs(mine - theirs).max() <= 1e-12 * np.abs(theirs).max()
    assert quickest(loop, 5) > 30 * quickest(compiled, 50)


def quickest(function, repeats):
    durations = []
    for _ in range(repeats):
        start = time.perf_counter()
        function()
        durations.append(time.perf_counter() - start)
    return min(durations)
