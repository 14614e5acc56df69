"""Compiled loops over time: states that an effect or a valve carries from sample to sample.

Arrays in, arrays out: signals are (muscles, trials, samples) and constants (muscles,) unless a docstring says other.
"""

import numpy as np
from numba import njit

from stages.benchmark.blinded_rig.machine import Array


@njit(cache=True)
def fill_first_order(target: Array, tau: Array, step: float) -> Array:
    """First-order lag, exact over a step, settled on the first sample."""
    out = np.empty_like(target)
    for m in range(target.shape[0]):
        share = 1.0 - np.exp(-step / tau[m])
        for k in range(target.shape[1]):
            state = target[m, k, 0]
            for i in range(target.shape[2]):
                out[m, k, i] = state
                state += share * (target[m, k, i] - state)
    return out


@njit(cache=True)
def bouc_wen(velocity: Array, yield_contraction: Array, sharpness: float, step: float) -> Array:
    """Bouc-Wen memory in [-1, 1] (Wen 1976), with beta = gamma = .5; the substeps keep it stable."""
    out = np.empty_like(velocity)
    for m in range(velocity.shape[0]):
        for k in range(velocity.shape[1]):
            z = 0.0
            for i in range(velocity.shape[2]):
                move = velocity[m, k, i] * step / yield_contraction[m]
                for _ in range(2):
                    grip = abs(z) ** sharpness
                    z += 0.5 * move * (1.0 - grip * (0.5 + 0.5 * np.sign(move * z)))
                out[m, k, i] = z
    return out


@njit(cache=True)
def lugre_state(velocity: Array, presliding: Array, excess: float, stribeck: float, step: float) -> Array:
    """LuGre friction over its Coulomb level (Canudas de Wit 1995); ``excess`` is static over Coulomb, less one."""
    out = np.empty_like(velocity)
    for m in range(velocity.shape[0]):
        for k in range(velocity.shape[1]):
            z = 0.0
            for i in range(velocity.shape[2]):
                v = velocity[m, k, i]
                level = 1.0 + excess * np.exp(-((v / stribeck) ** 2))
                goal = np.sign(v) * level
                z = goal + (z - goal) * np.exp(-abs(v) * step / (presliding[m] * level))
                out[m, k, i] = z
    return out


@njit(cache=True)
def fill_unevenly(target: Array, tau: Array, uneven: Array, softness: float, step: float) -> Array:
    """Lag whose time constant is exp(uneven) longer venting than filling, blended over ``softness``."""
    out = np.empty_like(target)
    for m in range(target.shape[0]):
        for k in range(target.shape[1]):
            state = target[m, k, 0]
            for i in range(target.shape[2]):
                out[m, k, i] = state
                drop = state - target[m, k, i]
                now = tau[m] * np.exp(0.5 * uneven[m] * np.tanh(drop / softness))
                state -= (1.0 - np.exp(-step / now)) * drop
    return out


@njit(cache=True)
def fill_limited(target: Array, tau: Array, fastest: Array, step: float) -> Array:
    """Lag whose flow saturates smoothly at ``fastest`` per second."""
    out = np.empty_like(target)
    for m in range(target.shape[0]):
        share = 1.0 - np.exp(-step / tau[m])
        most = fastest[m] * tau[m]
        for k in range(target.shape[1]):
            state = target[m, k, 0]
            for i in range(target.shape[2]):
                out[m, k, i] = state
                state += share * most * np.tanh((target[m, k, i] - state) / most)
    return out


@njit(cache=True)
def fill_through_tube(target: Array, tau: Array, tube_tau: Array, turbulence: float, step: float) -> Array:
    """Set a tube of its own volume ahead of the lag; its flow grows less than the pressure drop, as if turbulent."""
    out = np.empty_like(target)
    for m in range(target.shape[0]):
        share = 1.0 - np.exp(-step / tau[m])
        for k in range(target.shape[1]):
            tube = target[m, k, 0]
            state = tube
            for i in range(target.shape[2]):
                out[m, k, i] = state
                drop = target[m, k, i] - tube
                now = tube_tau[m] * np.sqrt(1.0 + abs(drop) / turbulence)
                kept = 1.0 - np.exp(-step / now)
                mean = tube + drop * (1.0 - kept * now / step)
                tube += kept * drop
                state += share * (mean - state)
    return out


@njit(cache=True)
def fill_leaking(target: Array, tau: Array, leak: Array, step: float) -> Array:
    """Lag with a flow out in proportion to the gauge pressure, ``leak`` per second; starts settled."""
    out = np.empty_like(target)
    for m in range(target.shape[0]):
        rate = 1.0 / tau[m] + leak[m]
        for k in range(target.shape[1]):
            state = target[m, k, 0] / (tau[m] * rate)
            for i in range(target.shape[2]):
                out[m, k, i] = state
                state += (1.0 - np.exp(-rate * step)) * (target[m, k, i] / (tau[m] * rate) - state)
    return out


@njit(cache=True)
def late_by(signal: Array, delay: Array) -> Array:
    """Signal ``delay`` samples late, linear between samples; before its first sample it held that one."""
    out = np.empty_like(signal)
    for m in range(signal.shape[0]):
        whole = int(np.floor(delay[m]))
        part = delay[m] - whole
        for k in range(signal.shape[1]):
            for i in range(signal.shape[2]):
                newer, older = max(i - whole, 0), max(i - whole - 1, 0)
                out[m, k, i] = (1.0 - part) * signal[m, k, newer] + part * signal[m, k, older]
    return out
