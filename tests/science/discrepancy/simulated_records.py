"""Records of machines by small steps of a rule of their own, which the project's integrators had no part in."""

import numpy as np
import pandas as pd
from omegaconf import OmegaConf
from scipy.integrate import solve_ivp

from stages.science.output_channels.whole_record_channel import build_whole_records
from stages.science.plant.machine import read_machine
from tests.composing import compose_values
from tests.science.discrepancy.searches import DISCREPANCY

FINE = 20
"""Steps within a sample."""
RATE_HZ, OMEGA = 610.3515625, 2 * np.pi * 68.0
NOISE_V, WANDER_V = 0.0005, 0.0005


def build_records(signals, trials, plant):
    """Return the output channel of records, with the stated limits of detection."""
    return build_whole_records(signals, trials, plant, DISCREPANCY.detection)


def wander(generator, samples, width):
    """A smooth random signal of unit deviation."""
    window = np.hanning(width)
    return np.convolve(generator.standard_normal(samples + width - 1), window / np.linalg.norm(window), mode="valid")


def rub(velocity, slow):
    return velocity / np.sqrt(velocity**2 + slow**2)


def drive(seed, coulomb=0.0, viscous=0.0, held=False, noise=2e-5, samples=3000, step_s=0.005, jitter=0.2):
    """A mass of 50 kg that a controller moves along a random way; friction in N and N s/m, jitter of the force in N."""
    generator = np.random.default_rng(seed)
    way = 0.15 * wander(generator, samples, 600)
    speed = np.gradient(way, step_s)
    force, position = np.empty(samples), np.empty(samples)
    x, v, aimed = way[0], speed[0], 0.0
    for k in range(samples):
        position[k], force[k] = x, aimed
        aimed = 4000.0 * (way[k] - x) + 600.0 * (speed[k] - v) + jitter * generator.standard_normal()
        for i in range(FINE):
            pushed = force[k] + 3.0 + (0.0 if held else (i + 0.5) / FINE * (aimed - force[k]))
            v += step_s / FINE * (pushed - coulomb * rub(v, 1e-3) - viscous * v) / 50.0
            x += step_s / FINE * v
    return {"force_n": force, "position_m": position + noise * generator.standard_normal(samples)}, step_s


def at(signal, k, i):
    """A signal some fine steps after a sample, or before the first as it was then, on the straight line to the next."""
    k, i = divmod(max(k * FINE + i, 0), FINE)
    return signal[k] + i / FINE * (signal[min(k + 1, len(signal) - 1)] - signal[k])


def trail(signal, tau_s, step_s):
    """What follows a signal through a filter of first order."""
    late = np.full(len(signal), signal[0])
    for k in range(1, len(signal)):
        late[k] = late[k - 1]
        for i in range(FINE):
            middle = 0.5 * (at(signal, k - 1, i) + at(signal, k - 1, i + 1))
            late[k] += step_s / FINE / tau_s * (middle - late[k])
    return late


def integrate(pull, samples, step_s, start=0.0):
    """The places of what starts at rest and is accelerated by `pull(k, i, x, v)`."""
    places, x, v = np.empty(samples), start, 0.0
    for k in range(samples):
        places[k] = x
        for i in range(FINE):
            v += step_s / FINE * pull(k, i, x, v)
            x += step_s / FINE * v
    return places


def lag(seed, asymmetry=0.0, fastest=np.inf, noise=0.3, samples=3000, step_s=0.02):
    """A chamber of 100 kPa per V and 20 kPa at rest that fills in 0.35 s; `fastest` in V/s."""
    generator = np.random.default_rng(seed)
    steps = np.repeat(generator.uniform(1.0, 5.0, samples // 80 + 1), 80)[:samples]
    command = 0.5 * steps + 0.5 * (3.0 + wander(generator, samples, 60))
    level, x = np.empty(samples), command[0]
    for k in range(samples):
        level[k] = x
        for i in range(FINE):
            rate = (at(command, k, i) - x) / 0.35
            rate *= 1.0 + asymmetry if rate > 0.0 else 1.0 / (1.0 + asymmetry)
            x += step_s / FINE * min(max(rate, -fastest), fastest)
    pressure = 100.0 * level + 20.0 + noise * generator.standard_normal(samples)
    return {"command_v": command, "pressure_kpa": pressure}, step_s


def motor(seed, coulomb=0.0, fan=0.0, noise=0.02, samples=3000, step_s=0.01):
    """A motor of 10 rad/s per V and .15 s that turns both ways; friction in V, a fan in V at 10 rad/s."""
    generator = np.random.default_rng(seed)
    command = 1.5 * wander(generator, samples, 80)
    speed, x = np.empty(samples), 0.0
    for k in range(samples):
        speed[k] = 10.0 * x
        for i in range(FINE):
            pulled = at(command, k, i) - x - fan * x * abs(x)
            rubs = np.clip(pulled, -coulomb, coulomb) if x == 0.0 else coulomb * np.sign(x)
            onward = x + step_s / FINE * (pulled - rubs) / 0.15
            x = 0.0 if x * onward < 0.0 < coulomb else onward
    return {"command_v": command, "speed_rad_per_s": speed + noise * generator.standard_normal(samples)}, step_s


def joint(seed, coulomb=0.0, late=0, noise=5e-4, samples=3000, step_s=0.01):
    """A joint between two muscles, all over its inertia; dry friction in rad/s2, air that is late by some samples."""
    generator = np.random.default_rng(seed)
    differ, both = 60.0 * wander(generator, samples, 120), 30.0 * wander(generator, samples, 400)
    raising, lowering = 200.0 + differ + both, 200.0 - differ + both

    def turn(k, i, x, v):
        up, down = at(raising, k - late, i), at(lowering, k - late, i)
        return 0.5 * (up - down) + 1.0 - (20.0 + 0.1 * (up + down)) * x - 4.0 * v - coulomb * rub(v, 1e-2)

    angle = integrate(turn, samples, step_s) + noise * generator.standard_normal(samples)
    return {"pressure_1_kpa": raising, "pressure_2_kpa": lowering, "angle_rad": angle}, step_s


def pendulum(seed, noise=2e-3, samples=1600, step_s=0.02):
    """A pendulum of 5 rad/s that is pushed up to some 70 degrees, all over its inertia."""
    generator = np.random.default_rng(seed)
    pushed = 5.0 * wander(generator, samples, 40)
    angle = integrate(lambda k, i, x, v: at(pushed, k, i) - 25.0 * np.sin(x) - 0.8 * v, samples, step_s)
    return {"drive_v": pushed, "response_v": angle + noise * generator.standard_normal(samples)}, step_s


def bounce(seed, stop=0.0, play=0.0, noise=2e-3, samples=1600, step_s=0.02):
    """A mass on a spring of 5 rad/s, another of `stop` 1/s2 beyond 0.2, a drive of some play in rad/s2."""
    generator = np.random.default_rng(seed)
    pushed = 5.0 * wander(generator, samples, 40)
    acts = np.empty((samples - 1) * FINE)
    for step in range(len(acts)):
        now = at(pushed, *divmod(step, FINE))
        acts[step] = np.clip(acts[step - 1], now - play, now + play) if step else now

    def pull(k, i, x, v):
        return acts[min(k * FINE + i, len(acts) - 1)] - 25.0 * x - 0.8 * v - stop * max(x - 0.2, 0.0)

    way = integrate(pull, samples, step_s)
    return {"drive_v": pushed, "response_v": way + noise * generator.standard_normal(samples)}, step_s


def release(seed, coulomb=0.35, noise=1e-3, samples=300, step_s=0.02):
    """A pendulum of 6 rad/s that is let go from three angles, one after the other; dry friction in rad/s2."""
    generator = np.random.default_rng(seed)

    def fall(k, i, x, v):
        return -36.0 * np.sin(x) - 0.06 * v - coulomb * rub(v, 1e-2)

    told = [integrate(fall, samples, step_s, start) for start in (0.44, 0.31, 0.38)]
    angles = [each + noise * generator.standard_normal(samples) for each in told]
    both = [tabulate({"angle_rad": each}, step_s, name, 3) for name, each in zip("abc", angles, strict=True)]
    return tuple(pd.concat(tables, ignore_index=True) for tables in zip(*both, strict=True))


def belt(seed, noise=0.02, samples=1500, step_s=0.02):
    """A pulley on a springy belt that a slow motor drives either way, read by a counter that does not see which way."""
    generator = np.random.default_rng(seed)
    command = np.repeat(generator.choice([-1.0, 1.0], samples // 5 + 1), 5)[:samples]
    motor, torque = np.empty((samples, FINE)), 0.0
    for k in range(samples):
        for i in range(FINE):
            motor[k, i] = torque
            torque += step_s / FINE * (at(command, k, i) - torque) / 0.13
    speed = integrate(lambda k, i, x, v: 400.0 * (1.8 * motor[k, i] - x) - 5.0 * v, samples, step_s)
    return {"drive_v": command, "response_v": np.abs(speed) + noise * generator.standard_normal(samples)}, step_s


def move(seed, samples=4800, step_s=0.02):
    """The way of an element on a test bench, m: three waves."""
    generator = np.random.default_rng(seed)
    time = np.arange(samples) * step_s
    waves = [(0.02, 0.11), (0.01, 0.27), (0.005, 0.61)]
    return sum(a * np.sin(2.0 * np.pi * f * time + generator.uniform(0.0, 6.0)) for a, f in waves)


def slide(way, width):
    """Dahl's friction, which turns smoothly, as a differential equation of its own."""
    state = np.zeros(len(way))
    for k, step in enumerate(np.diff(way), start=1):
        state[k] = state[k - 1] + step / width * (1.0 - state[k - 1] * np.sign(step))
    return state


def tabulate(signals, step_s=0.02, record="a", blocks=16):
    """Return signals and blocks as the workflow reads them."""
    time = np.arange(len(next(iter(signals.values())))) * step_s
    rows = pd.DataFrame({"record": record, "time_s": time, **signals}).melt(["record", "time_s"], var_name="signal")
    size = len(time) // blocks
    starts = np.arange(blocks) * size * step_s
    return rows, pd.DataFrame({"record": record, "start_s": starts, "samples": size})


def configured(name):
    """The oscillator that `plant=...` describes."""
    return read_machine(OmegaConf.to_container(compose_values("workflow=discrepancy", f"plant={name}").plant))


def shake(generator, force, records=12, samples=1000):
    """Records of band-limited random motion; `force` (x, w) opposes it beside spring and damper, in spring units.

    Returns signals and blocks as the workflow reads them.
    """
    instants = np.arange(samples) / RATE_HZ
    lines = np.arange(2, 160) * 1.2
    phase = generator.uniform(0, 2 * np.pi, (len(lines), records))

    def drive(now):
        return 0.022 * np.sqrt(2 / len(lines)) * np.sin(2 * np.pi * lines[:, None] * now + phase).sum(axis=0)

    def rates(now, state):
        x, w = state.reshape(2, records)
        return np.concatenate([OMEGA * w, OMEGA * (drive(now) - x - 0.1 * w - force(x, w))])

    solved = solve_ivp(rates, (0, instants[-1]), np.zeros(2 * records), t_eval=instants, rtol=1e-6, atol=1e-8)
    motion = solved.y[:records].T + NOISE_V * generator.standard_normal((samples, records))
    motion += WANDER_V * np.sin(2 * np.pi * 0.4 * instants[:, None] + generator.uniform(0, 6, records))
    driven = np.array([drive(now) for now in instants])
    names, first = [f"record {k}" for k in range(records)], round(0.5 * RATE_HZ)
    told = [{"drive_v": driven[:, k], "response_v": motion[:, k]} for k in range(records)]
    signals = [tabulate(each, 1.0 / RATE_HZ, name)[0] for each, name in zip(told, names, strict=True)]
    blocks = pd.DataFrame({"record": names, "start_s": first / RATE_HZ, "samples": samples - first})
    return pd.concat(signals, ignore_index=True), blocks
