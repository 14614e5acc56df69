"""Records of elements on test benches, by equations of their own at small steps; laws are a little other."""

import numpy as np
from scipy.signal import lfilter, lsim, lti

FINE_HZ = 1000.0
PATH_NOISE, WANDER, BEGUN = 2e-4, 0.5, 20000
"""Noise of inputs over their range; wander of the answer over its noise; fine steps that it has gone on before."""


def follow(signal, tau_s):
    """A first-order lag, settled at first."""
    decay = np.exp(-1.0 / (FINE_HZ * tau_s))
    return lfilter([1.0 - decay], [1.0, -decay], signal, zi=[decay * signal[0]])[0]


def ring(signal, hertz, damping):
    """What a sensor that is a mass on a spring shows."""
    frequency, begun = 2.0 * np.pi * hertz, signal[0]
    sensor = lti([frequency**2], [1.0, 2.0 * damping * frequency, frequency**2])
    return lsim(sensor, signal - begun, np.arange(len(signal)) / FINE_HZ)[1] + begun


def roam(generator, samples, hertz):
    """A smooth random motion between -1 and 1."""
    begun = 4 * int(FINE_HZ)
    path = generator.standard_normal(samples + begun)
    for _ in range(3):
        path = follow(path, 0.5 / (np.pi * hertz))
    path = path[begun:] - path[begun:].mean()
    return path / np.abs(path).max()


def climb(generator, samples, low, high, tau_s):
    """Levels that are held for some seconds, through a lag."""
    held = int(generator.uniform(1.5, 3.0) * FINE_HZ)
    return follow(np.repeat(generator.uniform(low, high, samples // held + 2), held)[:samples], tau_s)


def yield_and_slide(path, width):
    """A loop between -1 and 1 that turns within a width, by Bouc's rule."""
    turned, now = np.zeros(len(path)), 0.0
    for k, step in enumerate(np.diff(path, prepend=path[0]) / width):
        now = min(max(now + step * (1.0 - now * abs(now) if step * now > 0.0 else 1.0), -1.0), 1.0)
        turned[k] = now
    return turned


def pull_muscle(generator, samples, hertz):
    contraction = 0.11 + 0.09 * roam(generator, samples, hertz)
    pressure = climb(generator, samples, 80.0, 480.0, 0.06)
    law = 2.9 * (1.0 - 1.2 * contraction) ** 2 - 1.05 + 0.02 * np.sin(9.0 * contraction + pressure / 160.0)
    force = 1.25 * pressure * law - 60.0 * contraction - 900.0 * contraction**2
    return {"pressure_kpa": pressure, "contraction": contraction}, force, contraction, pressure, -1.0


def push_cylinder(generator, samples, hertz):
    position = 0.1 * roam(generator, samples, hertz)
    first, second = (climb(generator, samples, 120.0, 600.0, 0.08) for _ in range(2))
    force = 0.804 * first - 0.69 * second - 40.0 * np.gradient(position, 1.0 / FINE_HZ)
    force *= 1.0 + 0.008 * np.sin(25.0 * position + first / 200.0)
    return {"p1_kpa": first, "p2_kpa": second, "position_m": position}, force, position, first + second, -1.0


def drag_damper(generator, samples, hertz):
    position = 0.02 * roam(generator, samples, 2.0 * hertz)
    speed, current = np.gradient(position, 1.0 / FINE_HZ), climb(generator, samples, 0.0, 2.0, 0.01)
    force = (600.0 + 500.0 * current) * speed / (1.0 + 0.3 * np.abs(speed)) + 800.0 * position + 20.0
    return {"current_a": current, "position_m": position, "speed_m_per_s": speed}, force, position, current, 1.0


def bend_finger(generator, samples, hertz):
    first, second = 100.0 + 90.0 * roam(generator, samples, hertz), 60.0 + 50.0 * roam(generator, samples, hertz)
    path = first - second
    angle = 0.004 * path * (1.0 + 0.08 * np.sin(path / 70.0)) - 1.5e-8 * path**3 + 0.05
    return {"p1_kpa": first, "p2_kpa": second}, angle, path, np.ones(samples), -1.0


BENCHES = {
    "muscle": (pull_muscle, "force_n", {"length": "contraction"}),
    "cylinder": (push_cylinder, "force_n", {"pressure": "p1_kpa", "second_pressure": "p2_kpa"}),
    "damper": (drag_damper, "force_n", {"speed": "speed_m_per_s"}),
    "finger": (bend_finger, "angle_rad", {"along": "p1_kpa", "against": "p2_kpa"}),
}
"""By machine: what simulates it, what it answers, and the keys that name its signals."""


def record_bench(machine, effect, size, seed, rate_hz, seconds=64.0, filter_s=0.0, rings=None, behind=()):
    """Return signals of a record at a rate; the effect has a size over half the answer's range.

    The answer's sensor may have a filter, or ring at some hertz with some damping. What acts may be behind what is
    recorded, by a lag of so many s by name; of fewer than none, the sensor of what is recorded has such a filter.
    """
    generator = np.random.default_rng([seed, len(machine)])
    samples = int(seconds * FINE_HZ)
    signals, answer, path, load, sign = BENCHES[machine][0](generator, samples, generator.uniform(0.25, 0.5))
    scale, load = 0.5 * np.ptp(answer), load / load.max()
    unit = path / (0.5 * np.ptp(path))
    rate = np.gradient(unit, 1.0 / FINE_HZ)
    quick = rate / np.abs(rate).mean()
    slides = np.tanh(quick / 0.06)
    added = {
        "none": lambda: 0.0,
        "coulomb_friction": lambda: slides,
        "load_dependent_friction": lambda: (0.25 + 1.2 * load) * slides,
        "lagged": lambda: (0.1 + 1.3 * follow(load, 0.2)) * slides,
        "hysteresis": lambda: yield_and_slide(unit, generator.uniform(0.1, 0.25)),
        "drag": lambda: 0.4 * quick * np.abs(quick),
        "creep": lambda: 2.5 * (unit - 0.6 * follow(unit, 1.0) - 0.4 * follow(unit, 6.0)),
    }[effect]()
    noise = 0.004 * scale
    wander = follow(generator.standard_normal(samples + BEGUN), 2.0)[BEGUN:]
    answer = answer + sign * size * scale * added + WANDER * noise * wander / wander.std()
    answer = follow(answer, filter_s) if filter_s else answer
    answer = ring(answer, *rings) if rings else answer
    for name, lag_s in dict(behind).items():
        ahead = signals[name] + lag_s * np.gradient(signals[name], 1.0 / FINE_HZ)
        signals[name] = ahead if lag_s > 0.0 else follow(signals[name], -lag_s)
    every = int(FINE_HZ / rate_hz)
    told = {name: each[::every] for name, each in signals.items()}
    told = {name: v + PATH_NOISE * np.ptp(v) * generator.standard_normal(len(v)) for name, v in told.items()}
    measured = answer[::every] + noise * generator.standard_normal(len(answer[::every]))
    return told | {BENCHES[machine][1]: measured}
