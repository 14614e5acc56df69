"""Generic features of an output's measured signals: the regressors of a flexible residual model.

An output flows in; out flow columns that follow no literature: powers, products, what was before, where a signal is and
which way it goes, how much has been moved, what the neighbours do, time.
"""

from itertools import combinations_with_replacement

import numpy as np
from numba import njit

from stages.science.output_channels.output_channel import Driver, OutputChannel
from stages.science.plant.learned_map import SESSION_TIME, TIME, LearnedMap
from stages.science.signals.histories import CHANGE, DISTANCE, RECENT, find_signal, lag
from stages.science.signals.trajectories import Array

LAGS = (0.02, 0.06, 0.2, 0.6, 2.0)
"""Time constants of first-order lags, in time scales of the channel."""
RISES = 4
"""Number of lags, shortest first, from which rises are formed."""
WIDTHS = (0.03, 0.1, 0.3, 1.0)
"""Half-widths of stop operators, in standard deviations of the signal."""
KINKS = (-1.0, 0.0, 1.0)
BUMPS = 8
"""Number of Gaussian bumps, spaced evenly over a signal's range."""
TURNING = 0.1
"""Width of the smoothed sign of a rate, in standard deviations of the rate."""
START = 0.5
"""Time constant of what happens at a trial's start, paces."""


def build_features(output: OutputChannel) -> Array:
    """Return generic features of an output's drivers, as the output responds to them, (T, K, F); zero where missing."""
    drivers, step = output.drivers(), output.step_s / output.time_scale_s
    own = [(each, _standardise(each.values)) for each in drivers if each.own]
    states = [signal for driver, signal in own if not driver.rate]
    rates = [signal for driver, signal in own if driver.rate]
    signals = [signal for _, signal in own]
    products = (chosen for degree in (1, 2, 3) for chosen in combinations_with_replacement(signals, degree))
    columns: list[Array] = [np.prod(chosen, axis=0) for chosen in products]
    scales = [np.ones_like(own[0][1]), *states]
    for driver, signal in own:
        columns += [each * scale for each in _list_past(driver, signal, step) for scale in scales]
    for place, signal in enumerate(states):
        beside = [each for other, each in enumerate(states) if other != place]
        columns += _look_around(signal, beside, step)
    for rate in rates:
        moved = np.cumsum(np.abs(rate), axis=0) * step
        columns += [moved * scale for scale in scales]
    changes = [signal - lag(signal, LAGS[1], step) for signal in states]
    for each in [driver for driver in drivers if not driver.own]:
        aside = _standardise(each.values)
        columns += [*_look_aside(aside, step), *(aside * signal for signal in signals)]
        columns += [aside * change for change in changes]
        columns += [np.abs(aside), np.abs(aside) * own[0][1]]
    columns += _session(output, states)
    features = np.empty((*output.present.shape, len(columns)))
    for place, column in enumerate(columns):
        features[:, :, place] = _standardise(column)
    answers = output.respond(features)
    answers[~output.present] = 0.0
    return answers


def list_memory(output: OutputChannel) -> Array:
    """Return what an output's own signals were, (T, K, F): recent means, stops that follow them up to a width."""
    step = output.step_s / output.time_scale_s
    own = [(each, _standardise(each.values)) for each in output.drivers() if each.own]
    columns: list[Array] = []
    for signal in (signal for driver, signal in own if not driver.rate):
        columns += [*(lag(signal, tau, step) for tau in LAGS), *(_stop(signal, width) for width in WIDTHS)]
    columns += [lag(signal, tau, step) for driver, signal in own if driver.rate for tau in LAGS[:2]]
    return np.stack([_standardise(column) for column in columns], axis=2)


def list_aside(output: OutputChannel) -> Array:
    """Return measured signals from elsewhere, (T, K, F): of other elements, upstream, and of how the motion changes."""
    aside = [_standardise(each.values) for each in output.drivers() if not each.own]
    return np.stack(aside, axis=2) if aside else np.empty((*output.measured.shape, 0))


def list_histories(output: OutputChannel) -> list[Driver]:
    """Return the past of an output's signals: where each was lately, the distance moved so far, how others change.

    Their names are those by which `histories.find_signal` finds them.
    """
    found = []
    for each in output.drivers():
        name = f"{(DISTANCE if each.rate else RECENT) if each.own else CHANGE} {each.name}"
        history = find_signal(name, {each.name: each.values}, output.step_s, output.time_scale_s)
        found.append(Driver(name, history, own=False))
    return found


def list_inputs(output: OutputChannel) -> list[Driver]:
    """Return what a residual may depend on: an output's drivers, their histories, time in trial and in session."""
    within = np.repeat((np.arange(len(output.measured)) * output.step_s)[:, None], output.trials, axis=1)
    times = [Driver(TIME, within, own=False), Driver(SESSION_TIME, within + output.start_s, own=False)]
    return [*output.drivers(), *list_histories(output), *times]


def evaluate_map(learned: LearnedMap, output: OutputChannel) -> Array:
    """Return what a learned map adds to an output, (T, K), in its unit; see `LearnedMap.evaluate`."""
    return learned.evaluate({each.name: each.values for each in list_inputs(output)})


def share_outside(learned: LearnedMap, output: OutputChannel) -> float:
    """Return the share of an output's samples at which a map is beyond where it was learnt."""
    return learned.share_outside({each.name: each.values for each in list_inputs(output)}, output.present)


def _list_past(driver: Driver, signal: Array, step: float) -> list[Array]:
    """Return what one signal was: recent means, rises, stops that follow it up to a width; or its direction."""
    if driver.rate:
        directions = [np.tanh(signal / width) for width in (TURNING, 0.5)]
        return [*directions, signal * np.abs(signal), lag(signal, LAGS[0], step), lag(signal, LAGS[1], step)]
    lags = [lag(signal, tau, step) for tau in LAGS]
    rises = [np.maximum(signal - each, 0.0) for each in lags[:RISES]]
    kinks = [np.maximum(signal - kink, 0.0) for kink in KINKS]
    return [
        *lags,
        *rises,
        *(lag(rise, LAGS[1], step) for rise in rises),
        *(_stop(signal, width) for width in WIDTHS),
        *kinks,
    ]


def _look_around(signal: Array, beside: list[Array], step: float) -> list[Array]:
    """Return where a signal is, alone, by its direction, and by another's size."""
    low, high = np.quantile(signal, [0.02, 0.98])
    width = max((high - low) / (BUMPS - 1), 1e-9)
    rate = np.gradient(signal, step, axis=0)
    direction = np.tanh(rate / max(TURNING * float(rate.std()), 1e-12))
    bumps = [np.exp(-0.5 * ((signal - place) / (0.7 * width)) ** 2) for place in np.linspace(low, high, BUMPS)]
    return [bump * each for bump in bumps for each in (np.ones_like(signal), direction, *beside)]


def _look_aside(signal: Array, step: float) -> list[Array]:
    """Return what a signal from elsewhere was, how it curves, and how it rises."""
    soon, late = lag(signal, LAGS[1], step), lag(signal, LAGS[3], step)
    rise = signal - lag(signal, LAGS[0], step)
    return [signal, signal**2, soon, late, rise, lag(np.maximum(rise, 0.0), LAGS[1], step)]


def _session(output: OutputChannel, states: list[Array]) -> list[Array]:
    samples, step = output.measured.shape[0], output.step_s / output.time_scale_s
    within = np.repeat((np.arange(samples) * step)[:, None], output.trials, axis=1)
    session = _standardise(within + output.record_start_s / output.time_scale_s)
    order = _standardise(np.repeat(np.arange(output.trials)[None, :], samples, axis=0).astype(float))
    time = _standardise(within)
    trends = [each * signal for each in (session, time) for signal in states]
    return [time, time**2, session, session**2, *trends, order, np.exp(-within / START)]


def _standardise(signal: Array) -> Array:
    spread = float(signal.std())
    return (signal - signal.mean()) / spread if spread > 0.0 else np.zeros_like(signal)


@njit(cache=True, error_model="numpy")
def _stop(signal: Array, width: float) -> Array:
    stop = np.zeros_like(signal)
    for t in range(1, signal.shape[0]):
        for k in range(signal.shape[1]):
            stop[t, k] = min(max(stop[t - 1, k] + signal[t, k] - signal[t - 1, k], -width), width)
    return stop
