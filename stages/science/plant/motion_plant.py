"""A machine with one motion, told as accelerations: what its inputs bring, what holds it, what damps it.

Signals of records flow in; the motion flows out. A subclass says how constants make the three; effects of the site
`motion` act in all of them, in the machine's own scales.
"""

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from stages.science.plant.declaration import Declared
from stages.science.plant.effect import Signals, Values
from stages.science.plant.effect_config import EffectConfig, NominalConstant
from stages.science.plant.filters import lag
from stages.science.plant.linear_guess import filter_derivatives, find_pace
from stages.science.plant.motion import SITE, WIDE, Between, MotionTerms, integrate, refine
from stages.science.plant.record_plant import (
    HEAD,
    Case,
    InitialState,
    Placed,
    Positive,
    RecordPlant,
    Tries,
    begin,
    collect,
    read_initial_state,
)
from stages.science.signals.trajectories import Array

FINEST = 0.2
"""Longest integration step, paces."""
FINEST_FILTER = 2.0
"""Shortest time constant of the filters by which constants are guessed, samples."""
QUICKER, MOST_HALVINGS = 0.5, 12
"""Share of the error that guesses at the usual pace leave, below which those at a quicker one are taken; most tries.

A machine that is moved much more slowly than it moves by itself shows its usual motion in little else than what rests.
"""


LAGGED, LAGS, TURNS = 20.0, 40, 5
"""Longest time constant, paces, of the lags by which the sign of an output is restored, how many are tried, and how
often it is told anew by what the machine does."""


def _compare(followed: Sequence[Array], sizes: Array) -> float:
    return float(np.corrcoef(np.abs(np.concatenate(followed)), sizes)[0, 1])


class _MotionEffect(EffectConfig):
    SITE = SITE


class Pull(NamedTuple):
    """What accelerates a motion, in the unit of the output and in seconds."""

    push: Array
    """What the inputs bring, (N, R)."""
    hold: float | Array
    """Of the spring, also (N, R)."""
    damping: float
    offset: float
    """What the sensor adds."""
    lag_s: float = 0.0
    """Time constant with which the push follows."""


Guess = dict[str, tuple[float, ...]]


class MotionConstants(Declared):
    """Constants of any motion that is recorded."""

    input_delay_s: NominalConstant = Field(description="by which the input acts later than recorded, within a sample")


class MotionPlant(RecordPlant):
    """Everything that simulating one motion takes."""

    SITE: ClassVar[str] = SITE
    TERMS: ClassVar = MotionTerms
    TOGETHER: ClassVar[int] = WIDE
    WATCHED: ClassVar[tuple[str, str]] = ("motion", "velocity")
    ORDER: ClassVar[int] = 2
    """Derivatives of signals by which constants are guessed."""
    FILTER: ClassVar[float] = 0.3
    """Time constant of the filters by which constants are guessed, paces."""

    between_samples: Between
    output_scale: Positive | None = Field(description="motion in which effects tell their sizes, unit of the output")
    time_scale_s: Positive | None = Field(description="time of a radian of the usual motion, s")
    effects: list[_MotionEffect]

    @property
    def pushing(self) -> tuple[str, ...]:
        """All inputs."""
        return self.inputs

    def list_starts(self, effect: Any, records: Sequence[Signals], step_s: float, constants: Values) -> Tries:
        """Return limits of the drive, see `list_limits`; and the machine that records show whose sign is restored."""
        if effect.unsigned and len(self.inputs) == 1:
            return self._list_signed_starts(effect, records, step_s)
        pushes = (self.pull(each, constants).push for each in records)
        return self.list_limits(effect, "drive", pushes, self.know("output_scale") / self.know("time_scale_s") ** 2)

    def _list_signed_starts(self, effect: Any, records: Sequence[Signals], step_s: float) -> Tries:
        """Return starts of a sensor that is blind to the sign, with constants guessed from outputs of both signs.

        The sign is first that of the input through the lag whose size follows the output best, and then that of what
        the machine so guessed does.
        """
        open_ones = {
            name: NominalConstant(unit=each.unit, start=None, low=None, high=None, sd=None)
            for name, each in self.nominal.items()
        }
        free = self.model_copy(
            update={"constants": type(self.constants)(**open_ones), "time_scale_s": None, "output_scale": None}
        )
        tries = []
        sizes = np.concatenate([each[self.output] for each in records])
        for tau_s in np.geomspace(step_s, LAGGED * self.know("time_scale_s"), LAGS):
            followed = [lag(each[self.inputs[0]][:, None], float(tau_s), step_s)[:, 0] for each in records]
            tries.append((_compare(followed, sizes), followed))
        alike, followed = max(tries, key=lambda each: each[0])
        told = None
        for _ in range(TURNS):
            signed = [
                {**each, self.output: np.copysign(each[self.output], path)}
                for each, path in zip(records, followed, strict=True)
            ]
            again = free.resolve_from_data(signed, step_s)
            followed = again._follow(signed, step_s)
            if told is not None and _compare(followed, sizes) <= alike:
                break
            told, alike = again, _compare(followed, sizes)
        starts = (told or free).starts
        kept = {each.name: float(np.clip(starts[each.name], each.low, each.high)) for each in self.parameters}
        return [{effect.parameters[0].name: 1.0, **kept}]

    @property
    def memory_s(self) -> float:
        """Time in which a free motion decays to a thousandth, s."""
        pulled = self.pull({name: np.zeros((1, 1)) for name in self.inputs}, self.starts)
        hold, damping = float(np.max(pulled.hold)), pulled.damping
        slowest = 0.5 * damping if damping**2 < 4.0 * hold else 0.5 * (damping - np.sqrt(damping**2 - 4.0 * hold))
        slowest = min(slowest, 1.0 / pulled.lag_s) if pulled.lag_s else slowest
        return float(np.log(1e3) / slowest) if slowest > 0.0 and not self.drifts else np.inf

    @abstractmethod
    def pull(self, signals: Signals, constants: Values) -> Pull:
        """Return what accelerates the motion under inputs (N, R), at whatever instants."""

    @abstractmethod
    def guess(self, derivatives: Mapping[str, Sequence[Array]], skipped: int) -> Guess:
        """Return start, bounds and deviation of each constant.

        Signals of each record come with `ORDER` derivatives, (N_r, ORDER + 1), through the same filter, which settles
        in so many samples that are skipped; `""` is the name of the number one.
        """

    def resolve_from_data(self, records: Sequence[Signals], step_s: float) -> Self:
        """Return the plant with the scales and constants that were left open; see `RecordPlant.resolve_from_data`."""
        outputs = [each[self.output] for each in records]
        usual_s = self.time_scale_s or max(find_pace(outputs, step_s), step_s)
        scale = self.output_scale or max(0.5 * max(float(np.ptp(each)) for each in outputs), 1e-12)
        opened = self.model_copy(update={"output_scale": scale, "time_scale_s": usual_s})
        if all(each.start is not None for each in self.nominal.values()):
            return opened
        settled = opened._guess_constants(records, step_s)
        if self.time_scale_s:
            return settled
        settled = settled._follow_nature(records)
        if self.drifts:
            return settled
        least = QUICKER * settled._miss(records, step_s)
        for halvings in range(1, MOST_HALVINGS):
            quicker_s = usual_s * 0.5**halvings
            if self.FILTER * quicker_s < FINEST_FILTER * step_s:
                break
            quicker = opened.model_copy(update={"time_scale_s": quicker_s})
            tried = quicker._guess_constants(records, step_s)._follow_nature(records)
            missed = tried._miss(records, step_s)
            if missed < least:
                least, settled = missed, tried
        return settled

    def _guess_constants(self, records: Sequence[Signals], step_s: float) -> Self:
        """Return the plant with constants told by records through filters of its pace."""
        tau_s = max(self.FILTER * self.know("time_scale_s"), FINEST_FILTER * step_s)
        filtered = {
            name: [filter_derivatives(each[name], self.ORDER, tau_s, step_s) for each in records]
            for name in (*self.inputs, self.output)
        }
        ones = [np.ones(len(each[self.output])) for each in records]
        filtered[""] = [filter_derivatives(each, self.ORDER, tau_s, step_s) for each in ones]
        guessed = self.guess(filtered, int(np.ceil(8.0 * tau_s / step_s)))
        guessed["input_delay_s"] = (0.0, -step_s, step_s, 0.5 * step_s)
        return self.fill_in(guessed)

    def _follow_nature(self, records: Sequence[Signals]) -> Self:
        """Return the plant at the pace of its free motion, or of that in which the usual push brings one scale."""
        joined = {name: np.concatenate([each[name] for each in records])[:, None] for name in self.inputs}
        pulled = self.pull(joined, self.starts)
        hold, push = float(np.mean(pulled.hold)), float(np.sqrt((pulled.push**2).mean()))
        pace_s = 1.0 / np.sqrt(hold) if hold > 0.0 else np.sqrt(self.know("output_scale") / max(push, 1e-300))
        return self.model_copy(update={"time_scale_s": float(pace_s)})

    def _miss(self, records: Sequence[Signals], step_s: float) -> float:
        """Return the root mean square by which the guessed constants miss what was measured."""
        missed = np.concatenate(self._follow(records, step_s)) - np.concatenate([each[self.output] for each in records])
        return float(np.sqrt(np.mean(missed**2)))

    def _follow(self, records: Sequence[Signals], step_s: float) -> list[Array]:
        """Return the motions that the guessed constants tell, one of each record."""
        followed = []
        for each in records:
            signals = {name: values[:, None] for name, values in each.items()}
            begun = read_initial_state([each[self.output][:HEAD]], step_s)
            followed.append(self.simulate(self.refine(signals, step_s), step_s, np.zeros(1), self.starts, (), begun))
        return [each[:, 0] for each in followed]

    def thin_out(self, stride: int) -> Self:
        """Return the plant for records of which every so many samples became their mean: such inputs are means."""
        return self.model_copy(update={"between_samples": "averaged"}) if stride > 1 else self

    def refine(self, signals: Signals, step_s: float) -> Signals:
        """Return signals with inputs at the instants that the integrator looks at."""
        refined = {name: refine(signals[name], self._substeps(step_s), self.between_samples) for name in self.inputs}
        return {**signals, **refined}

    def _substeps(self, step_s: float) -> int:
        return max(int(np.ceil(step_s / self.know("time_scale_s") / FINEST)), 2)

    def simulate(
        self,
        signals: Signals,
        step_s: float,
        start_s: Array,
        constants: Values,
        effects: Sequence[Placed] = (),
        begun: InitialState | None = None,
    ) -> Array:
        """Return the motion, (T, R); see `RecordPlant.simulate`."""
        return self.simulate_each(signals, step_s, start_s, [(constants, effects)], begun)[:, :, 0]

    def simulate_each(
        self, signals: Signals, step_s: float, start_s: Array, cases: Sequence[Case], begun: InitialState | None = None
    ) -> Array:
        """Return the motions of several cases, (T, R, C); see `RecordPlant.simulate_each`."""
        scale, time_scale_s = self.know("output_scale"), self.know("time_scale_s")
        pace, substeps = step_s / time_scale_s, self._substeps(step_s)
        pulls = [self.pull(signals, constants) for constants, _ in cases]
        records = pulls[0].push.shape[1]
        terms = [collect(MotionTerms, SITE, self.place(effects)) for _, effects in cases]
        lags = [each.lag_s / time_scale_s for each in pulls]
        terms = [each._replace(drive_lag=each.drive_lag + late) for each, late in zip(terms, lags, strict=True)]
        terms = [each for each in terms for _ in range(records)]
        drive = np.concatenate([(time_scale_s**2 / scale * each.push).T for each in pulls])
        holds = [each.hold * np.ones((1, records)) for each in pulls]
        hold = np.concatenate([(time_scale_s**2 * each).T for each in holds])
        damping = np.repeat([each.damping * time_scale_s for each in pulls], records)
        late = np.repeat([constants["input_delay_s"] / step_s for constants, _ in cases], records)
        offset = np.repeat([each.offset for each in pulls], records)
        stays = self.between_samples == "held"

        def run(state: Array, chosen: NDArray[np.int_], samples: int) -> Array:
            upto = (samples - 1) * 2 * substeps + 1
            pushed, holding = (each[:, :upto][chosen] for each in (drive, hold))
            kept = [terms[k] for k in chosen]
            its = (damping[chosen], kept, pace, substeps, late[chosen], offset[chosen] / scale)
            return integrate(pushed, holding, state, *its, stays)

        state = np.zeros((2, len(terms)))
        if begun is not None:
            told = InitialState(*(np.tile(each, len(cases)) for each in begun))
            state = np.stack([told.value - offset, told.rate * time_scale_s]) / scale
            if self.output in signals:  # its own motion refines what the first samples tell
                heads = (np.tile(signals[self.output][: None if self.drifts else HEAD], len(cases)) - offset) / scale
                errors = np.maximum(np.stack([told.value_error, told.rate_error * time_scale_s]) / scale, 1e-6)
                told_by = run, state, errors, heads, told.noise / scale
                state = begin(*told_by)
                if self.drifts:  # the first steps may begin so far away that what is left counts as noise
                    state = begin(*told_by, state)
        motion = integrate(drive, hold, state, damping, terms, pace, substeps, late, offset / scale, stays)
        return (offset + scale * motion).reshape(len(motion), len(cases), records).transpose(0, 2, 1)
