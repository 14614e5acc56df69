"""The one channel of a machine that is simulated a whole record at a time, cut into blocks that serve as trials.

Signals of records and the list of their blocks flow in; an output flows out. A record is always simulated from its
beginning, however many of its blocks are looked at, so that memory is kept.
"""

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cache, cached_property
from multiprocessing import cpu_count, current_process
from typing import NamedTuple, Self

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from stages.science.output_channels.exact_values import Levels, find_levels
from stages.science.output_channels.features import evaluate_map
from stages.science.output_channels.fitting import Model, fit
from stages.science.output_channels.noise import make_plain
from stages.science.output_channels.output_channel import Case, DetectionSettings, Driver, OutputChannel, Placed
from stages.science.output_channels.records import bridge, bridge_short, spread_records, thin_out
from stages.science.plant.effect import NamedEffect, list_effects
from stages.science.plant.effect_config import list_effects_at
from stages.science.plant.filters import lag
from stages.science.plant.record_plant import HEAD, NOTHING, InitialState, RecordPlant, Watched, read_initial_state
from stages.science.recording.signal_names import name_signal, per_second
from stages.science.recording.units import own_unit
from stages.science.signals.trajectories import Array

EXACT, FULL = "saturation", "full_tank"
"""Effect whose levels exactly repeated values show, and its form that is a level of the vessel, not of the sensor."""
BELOW = 0.05
"""Range below zero over all of it, of an output that is no noise about zero."""
AVERAGED, ROUNDED = 3e-4, 1e-6
"""Numerical error over a signal's range: of averaged samples, and of rounding and integration."""
LATELY = (0.02, 0.06, 0.2, 0.6)
"""Times of a movement by which a gain may follow late."""
FEWEST = 10
"""Least number of samples of a block."""
LEAST_BLOCKS = 3
"""Least number of blocks: one for testing, two to leave out in turn."""
SAME, LARGEST = 1e-12, 1e100
"""Relative range of an output up to which it is constant, and largest size whose square is finite."""
LONG = 10000
"""Number of samples from which simulations run in threads, but for those in a fork of the process."""
LEVEL_ERROR = 0.001
"""Standard deviation of a saturation level read off exactly repeated values, in scales of the output."""


class _Group(NamedTuple):
    """Records that are simulated side by side: when and how each begins, inputs (T, R), first samples of the output."""

    records: tuple[int, ...]
    start_s: Array
    signals: Mapping[str, Array]
    begun: InitialState


@dataclass
class WholeRecordChannel(OutputChannel):
    """Blocks of a machine's records."""

    plant: RecordPlant
    """Resolved from the data; effects that it lists already act."""
    step_s: float
    records: tuple[Mapping[str, Array], ...]
    """Inputs and output of each record, (N_r,), gaps bridged."""
    places: tuple[tuple[int, int], ...]
    """Record and first sample of each block."""
    measured: Array
    present: NDArray[np.bool_]
    start_s: Array
    begun: tuple[InitialState, ...]
    """How each record begins."""
    limits: DetectionSettings
    beside: tuple[str, ...]
    """Signals of the records that the plant does not name; what they explain gets no effect's name."""
    averaged: int
    forgotten: int
    watched: Mapping[str, float] | None = None
    """Constants by which drivers are told; those of a fit as if the residual were white, without."""
    jitters = False

    def __post_init__(self) -> None:
        plant = self.plant
        self.channel, self.unit, self.time_scale_s = plant.output, own_unit(plant.output), plant.movement_s
        self.element, self.constants, self.other_starts = plant.element, plant.parameters, plant.other_starts
        self.resolution = (AVERAGED if self.averaged > 1 else ROUNDED) * self.range

    @property
    def forms(self) -> tuple[NamedEffect, ...]:
        """Effects at the plant's site that it does not list yet; a level that exact values show is theirs."""
        taken = {entry.name for entry in self.plant.effects}
        found = list_effects_at(self.plant.SITE, [name for name in list_effects() if name not in taken])
        below_zero = self.measured[self.present].min(initial=0.0) < -BELOW * self.range
        return tuple(
            self._read_level(replace(each, scales=each.scales and not self.plant.drifts, tried=True))
            for each in found
            if not self.plant.find_lacking(each) and not (getattr(each, "unsigned", False) and below_zero)
        )

    def _read_level(self, form: NamedEffect) -> NamedEffect:
        """Return a form with the parameter at the level that exact values show, if they do."""
        shown, error = self._show(form) if _is_exact(form) else {}, LEVEL_ERROR
        told = tuple(
            replace(each, low=value - error, high=value + error, prior_mean=value, prior_sd=error, starts=(value,))
            for each in form.parameters
            if each.name in shown
            for value in [shown[each.name]]
        )
        return replace(form, parameters=told) if told else form

    def _show(self, form: NamedEffect) -> dict[str, float]:
        """Return what exact values show of a form's parameters: of its ends those that the sensor comes to, or none."""
        scale = self.plant.output_scale
        ends = {name: level for name, level in self._levels._asdict().items() if level is not None}
        if scale is None or not ends:
            return {}
        if form.form == FULL:
            return {form.parameters[0].name: scale / ends["highest"]} if ends.get("highest", 0.0) > 0.0 else {}
        return {form.parameters[0].name: 1.0, **{name: level / scale for name, level in ends.items()}}

    @cached_property
    def _levels(self) -> Levels:
        """Levels at which the output is clipped, as far as its exact values show them."""
        return find_levels(np.where(self.present, self.measured, np.nan), self.limits)

    def simulate(self, constants: Mapping[str, float], effects: Placed) -> Array:
        """Return the answer of the blocks, (T, K)."""
        return self.simulate_each([(constants, effects)])[:, :, 0]

    def simulate_each(self, cases: Sequence[Case]) -> Array:
        """Return the answer of the blocks in several cases, (T, K, C)."""
        samples = sum(group.signals[self.plant.output].size for group in self._groups) * len(cases)
        share = -(-len(cases) // cpu_count()) if samples >= LONG else len(cases)
        tasks = [
            (group, cases[first : first + many])
            for group in self._groups
            for many in [max(min(self.plant.TOGETHER // len(group.records), share), 1)]
            for first in range(0, len(cases), many)
        ]

        def work(task: tuple[_Group, Sequence[Case]]) -> Array:
            group, taken = task
            return self.plant.simulate_each(group.signals, self.step_s, group.start_s, taken, group.begun)

        several = samples >= LONG and len(tasks) > 1 and not current_process().daemon
        found = list(_start_threads(current_process().pid or 0).map(work, tasks)) if several else map(work, tasks)
        whole: dict[int, list[Array]] = {}
        for (group, _), simulated in zip(tasks, found, strict=True):
            for place, record in enumerate(group.records):
                whole.setdefault(record, []).append(simulated[:, place])
        answers = self._cut({record: np.concatenate(each, axis=1) for record, each in whole.items()})
        return answers + self._learned[:, :, None] if self.plant.learned else answers

    @cached_property
    def _learned(self) -> Array:
        """What the plant's learned maps add, (T, K)."""
        told = self.told_by(self.plant.starts) if self.watched is None else self
        return np.sum([evaluate_map(each, told) for each in self.plant.learned], axis=0)

    def told_by(self, constants: Mapping[str, float]) -> Self:
        """Return the output whose drivers are told by these constants."""
        return replace(self, watched=constants)

    @property
    def independent_trials(self) -> int:
        """Number of records, whose blocks share a zero and a gain; of blocks, where there is no other record."""
        return self.trials if len(self._used) == 1 else len(self._used)

    @cached_property
    def _groups(self) -> list[_Group]:
        """Records that have a block, those of one length together."""
        begins_s = {record: at for (record, _), at in zip(self.places, self.start_s - self.record_start_s, strict=True)}
        lengths: dict[int, list[int]] = {}
        for record in self._used:
            lengths.setdefault(len(self.records[record][self.plant.output]), []).append(record)
        groups = []
        for length, records in lengths.items():
            names = self.records[records[0]]
            signals = {name: np.stack([self.records[record][name] for record in records], axis=1) for name in names}
            if self.plant.drifts:
                output = np.stack([self._shown[record] for record in records], axis=1)
            else:
                head = max(HEAD // self.averaged, 3)  # samples by which how a record begins may be refined
                output = np.where(np.arange(length)[:, None] < head, signals[self.plant.output], np.nan)
            signals[self.plant.output] = output
            begun = InitialState(*np.concatenate([self.begun[record] for record in records], axis=1))
            start_s = np.array([begins_s[record] for record in records])
            groups.append(_Group(tuple(records), start_s, self.plant.refine(signals, self.step_s), begun))
        return groups

    @property
    def record_start_s(self) -> Array:
        """Start of each block in its record, (K,), s."""
        return np.array([first for _, first in self.places]) * self.step_s

    @cached_property
    def _shown(self) -> dict[int, Array]:
        """Output of the records that have a block, NaN where no block shows it."""
        return self._join(self.measured)

    def _join(self, blocks: Array) -> dict[int, Array]:
        """Return the records of which these are blocks, (T, K), NaN where no block shows the output."""
        shown = {record: np.full(len(self.records[record][self.plant.output]), np.nan) for record in self._used}
        for k, (record, first) in enumerate(self.places):
            at = first + np.flatnonzero(self.present[:, k])
            shown[record][at] = blocks[self.present[:, k], k]
        return shown

    @cached_property
    def _seen(self) -> list[Mapping[str, Array]]:
        """Inputs of the records that have a block, and their output as far as these blocks show it."""
        shown = self._shown.items()
        return [{**self.records[record], self.plant.output: bridge(pd.Series(each))} for record, each in shown]

    @property
    def _used(self) -> list[int]:
        return sorted({record for record, _ in self.places})

    @cached_property
    def _linear(self) -> dict[str, float]:
        """Constants of the nominal model, fitted as if the residual were white."""
        model = Model(self)
        return model.name_values(fit(model, make_plain(max(0.01 * self.range, 1e-9)), model.start).values)[0]

    def drivers(self) -> list[Driver]:
        """Return what the plant watches, cut into blocks."""
        watched = self._watch()
        first = watched[self._used[0]]
        if len({each.rate for each in first}) < 2:
            told = ", ".join(f"{each.name} (rate={each.rate})" for each in first) or "none"
            raise ValueError(
                f"{type(self.plant).__name__}.watch: expected a state, Watched(name, samples, False), and a rate whose "
                f"sign is a direction, Watched(name, samples, True); got {told}"
            )
        own = []
        for place, (name, _, rate, like, factor) in enumerate(first):
            unit = name_signal(like)[1]
            values = self._cut({k: each[place].samples[:, 0] for k, each in watched.items()})
            own.append(Driver(name, values, True, rate, per_second(unit) if rate and like else unit, factor))
        aside = [Driver(name, self._cut({k: self.records[k][name] for k in self._used}), False) for name in self.beside]
        return own + aside

    def _watch(self) -> dict[int, list[Watched]]:
        """Return what the plant watches in whole records."""
        constants = self.watched or (self.plant.starts if self.plant.learned else self._linear)
        watched = {}
        for record in self._used:
            signals = {name: values[:, None] for name, values in self.records[record].items()}
            watched[record] = self.plant.watch(signals, self.step_s, constants)
        return watched

    def respond(self, features: Array) -> Array:
        """Return the features of a flexible model as the plant's output answers to them."""
        return self.plant.respond(features, self.step_s)

    def recall(self, most: int, answer: Array | None = None) -> Array:
        """Return the inputs, or an answer, at each sample and at those before it, at most `most` columns, (T, K, F)."""
        if answer is None:
            whole = [{k: self.records[k][name] for k in self._used} for name in self.plant.inputs]
        else:
            shown = self._join(answer)
            whole = [{k: bridge(pd.Series(each)) for k, each in shown.items()}]
        columns = []
        for each in whole:
            centred = {k: v - v.mean() for k, v in each.items()}
            for delay in range(most // len(whole)):
                late = {k: np.concatenate([np.zeros(delay), v])[: len(v)] for k, v in centred.items()}
                columns.append(self._cut(late))
        return np.stack(columns, axis=2)

    def mix(self) -> Array:
        """Return each watched signal times what changed in each that drives within some times of a movement."""
        if not self.plant.driving:
            return super().mix()
        watched = self._watch()
        driving = [each.name in self.plant.driving for each in watched[self._used[0]]]
        joined = {k: np.hstack([each.samples for each in signals]) for k, signals in watched.items()}
        together = np.concatenate(list(joined.values()))
        middle, spread = together.mean(axis=0), np.maximum(together.std(axis=0), 1e-300)
        columns: dict[int, Array] = {}
        for record, signals in joined.items():
            now = (signals - middle) / spread
            driven = now[:, driving]
            late = [driven - lag(driven, share * self.plant.movement_s, self.step_s) for share in LATELY]
            columns[record] = (now[:, :, None] * np.hstack(late)[:, None, :]).reshape(len(now), -1)
        places = range(len(driving) * sum(driving) * len(LATELY))
        cut = [self._cut({k: each[:, at] for k, each in columns.items()}) for at in places]
        return np.stack(cut, axis=2) if cut else super().mix()

    def starts(self, form: NamedEffect, constants: Mapping[str, float]) -> list[dict[str, float]]:
        """Return starting values of a form; of saturation the levels that repeated values show, or none."""
        if _is_exact(form):
            return [shown] if (shown := self._show(form)) else []
        told = self.plant.list_starts(form, self._seen, self.step_s, constants)
        return super().starts(form, constants) if told is None else told

    def shows(self, form: NamedEffect) -> bool:
        """Return whether the largest or the smallest value recurs exactly, and the form cuts off at levels."""
        return _is_exact(form) and self._levels != Levels(None, None)

    def take(self, trials: Sequence[int]) -> Self:
        """Return the output with some of its blocks, by position."""
        chosen = list(trials)
        places, starts = tuple(self.places[k] for k in chosen), self.start_s[chosen]
        measured = np.ascontiguousarray(self.measured[:, chosen])
        present = np.ascontiguousarray(self.present[:, chosen])
        return replace(self, places=places, measured=measured, present=present, start_s=starts)

    @property
    def levers(self) -> tuple[str, ...]:
        """The inputs that change in its records."""
        inputs = [name for name in dict.fromkeys(self.plant.inputs) if name != NOTHING]
        return tuple(name for name in inputs if any(not _is_still(self.records[k][name]) for k in self._used))

    def excite(self, shares: Mapping[str, Array]) -> Self:
        """Return the output in other records, each one block; they begin where the first record did."""
        shape = shares[self.levers[0]].shape
        seen = {name: np.concatenate([self.records[k][name] for k in self._used]) for name in self.records[0]}
        driven = {name: seen[name].min() + shares[name] * np.ptp(seen[name]) for name in self.levers}
        still = {name: np.full(shape, values[0]) for name, values in seen.items()}
        records = tuple(
            {name: np.ascontiguousarray(each[:, k]) for name, each in (still | driven).items()} for k in range(shape[1])
        )
        return replace(
            self,
            records=records,
            places=tuple((k, 0) for k in range(shape[1])),
            measured=np.zeros(shape),
            present=np.ones(shape, dtype=bool),
            start_s=np.full(shape[1], self.start_s.max() + self.step_s * len(self.measured)),
            begun=(self.begun[self._used[0]],) * shape[1],
        )

    def tell_levers(self) -> dict[str, Array]:
        """Return the inputs."""
        return {name: self._cut({k: self.records[k][name] for k in self._used}) for name in self.levers}

    def _cut(self, whole: Mapping[int, Array]) -> Array:
        """Return the blocks of whole records; beyond a record's end its last value."""
        samples = np.arange(len(self.measured))
        taken = [(whole[record], first) for record, first in self.places]
        return np.stack([values[np.minimum(first + samples, len(values) - 1)] for values, first in taken], axis=1)


@cache
def _start_threads(process: int) -> ThreadPoolExecutor:
    """Return the threads of a process; a forked one has none of its parent's."""
    return ThreadPoolExecutor(max_workers=cpu_count())


def _is_exact(form: NamedEffect) -> bool:
    """Return whether the parameters of a form are levels."""
    ends = {each.name for each in form.parameters} & set(Levels._fields)
    return form.name == EXACT and (form.form == FULL or bool(ends))


def build_whole_records(
    signals: pd.DataFrame, trials: pd.DataFrame, plant: RecordPlant, limits: DetectionSettings
) -> WholeRecordChannel:
    """Return the output of a machine's records.

    Parameters
    ----------
    signals : DataFrame
        Columns ``record``, ``time_s``, ``signal`` and ``value``; times evenly spaced within a record.
    trials : DataFrame
        Columns ``record``, ``start_s`` and ``samples``: the blocks, in the order of the arrays' last axis; and, where
        blocks are kept apart, ``left_before`` and ``left_after``: samples left out at their ends.

    Raises
    ------
    ValueError
        When one of the signals is missing or has no values, when the output never changes, or when there are too few
        samples.
    """
    names = (*plant.inputs, plant.output)
    records, step_s = spread_records(signals, [each for each in names if each != NOTHING])
    records = {name: rows.assign(**{NOTHING: 0.0}) for name, rows in records.items()}
    _check_records(records, trials, plant)
    beside = _list_beside(records, names)
    bridged = [{name: bridge(rows[name]) for name in names} for rows in records.values()]
    resolved = plant.resolve_from_data(bridged, step_s)
    stride = max(int(resolved.finest_s / step_s), 1)
    order = {name: k for k, name in enumerate(records)}
    thinned = []
    for rows in records.values():  # of inputs, also gaps of `stride` samples are bridged
        short = {name: bridge_short(rows[name], stride - (name == plant.output)) for name in (*names, *beside)}
        thinned.append(thin_out(pd.DataFrame(short), stride, resolved.pushing))
    first_s, step_s = step_s, step_s * stride
    filled = [{name: bridge(rows[name]) for name in (*names, *beside)} for rows in thinned]
    known = [_find_known(rows, plant, resolved.memory_s / step_s) for rows in thinned]
    samples = int(trials["samples"].max()) // stride
    begins_s = np.cumsum([0.0, *(len(rows) * step_s for rows in thinned)])
    places, measured, present, forgotten = [], [], [], 0
    for block in trials.to_dict("records"):
        record, first = order[str(block["record"])], round(block["start_s"] / step_s)
        before, after = (block.get(f"left_{end}", 0) for end in ("before", "after"))
        at = first + np.arange(samples)
        inside = (at >= first - (-before // stride)) & (at < first + (block["samples"] - after) // stride)
        inside &= at < len(known[record])
        at = np.minimum(at, len(known[record]) - 1)
        places.append((record, first))
        measured.append(filled[record][plant.output][at])
        present.append(inside & known[record][at])
        forgotten += int((inside & thinned[record][plant.output].notna().to_numpy()[at] & ~known[record][at]).sum())
    if np.sum(present) < FEWEST:
        lost = [name for name in plant.inputs if any(rows[name].isna().any() for rows in records.values())]
        lacking = f"; {', '.join(lost)} lack values, after which none counts for {resolved.memory_s:.3g} s"
        raise ValueError(
            f"signal {plant.output}: expected {FEWEST} samples or more with all that they are simulated from, got "
            f"{np.sum(present)}{lacking if lost else ''}"
        )
    return WholeRecordChannel(
        resolved.thin_out(stride),
        step_s,
        tuple(filled),
        tuple(places),
        np.stack(measured, axis=1),
        np.stack(present, axis=1),
        np.array([begins_s[record] + first * step_s for record, first in places]),
        tuple(read_initial_state([each[plant.output][:HEAD]], first_s, 0.5 * (step_s - first_s)) for each in bridged),
        limits,
        beside,
        stride,
        forgotten,
    )


def _list_beside(records: Mapping[str, pd.DataFrame], names: Sequence[str]) -> tuple[str, ...]:
    """Return the signals beside those named that change in some record."""
    others = dict.fromkeys(str(name) for rows in records.values() for name in rows if name not in (*names, NOTHING))
    together = {name: np.concatenate([bridge(rows[name]) for rows in records.values()]) for name in others}
    return tuple(name for name, each in together.items() if not _is_still(each))


def _is_still(values: Array) -> bool:
    return bool(np.ptp(values) <= SAME * np.abs(values).max(initial=0.0))


def _check_records(records: Mapping[str, pd.DataFrame], trials: pd.DataFrame, plant: RecordPlant) -> None:
    output = plant.output
    for name in () if plant.FREE else plant.inputs:
        if all((rows[name].fillna(0.0) == 0.0).all() for rows in records.values()):
            raise ValueError(f"signal {name}: expected an input that acts, got 0 throughout")
    pushed = {name: np.concatenate([rows[name].dropna() for rows in records.values()]) for name in plant.inputs}
    if pushed and not plant.FREE and all(_is_still(each) for each in pushed.values()):
        name, each = next(iter(pushed.items()))
        raise ValueError(
            f"signal {name}: expected an input that changes, got {each[0]:g} throughout; by that, nothing can be told "
            "apart"
        )
    values = np.concatenate([rows[output].dropna().to_numpy(dtype=float) for rows in records.values()])
    if _is_still(values):
        raise ValueError(f"signal {output}: expected an output that changes, got {values[0]:g} throughout")
    if np.abs(values).max() > LARGEST:
        raise ValueError(f"signal {output}: expected values below {LARGEST:g}, got {np.abs(values).max():g}")
    longest, samples = max(len(rows) for rows in records.values()), int(trials["samples"].max())
    if samples < FEWEST:
        most = longest // FEWEST
        raise ValueError(
            f"expected blocks of {FEWEST} samples or more, got {samples}: the longest record has {longest} samples; "
            "record more" + (f", or set measurement.blocks={most} or fewer" if most >= LEAST_BLOCKS else "")
        )


def _find_known(rows: pd.DataFrame, plant: RecordPlant, memory: float) -> NDArray[np.bool_]:
    """Return where a record's output was measured, and for a memory before it (samples) all inputs."""
    lost = rows[list(plant.inputs)].isna().any(axis=1).to_numpy()
    places = np.arange(len(rows))
    last = np.maximum.accumulate(np.where(lost, places, -1))
    known: NDArray[np.bool_] = rows[plant.output].notna().to_numpy() & ((last < 0) | (places - last > memory))
    return known
