"""An element on a test bench, of whatever law: it answers at once to what is measured while it is displaced.

Signals of records flow in; the answer flows out. A subclass says how constants make the answer; effects of the site
`element` change it, in the element's own scales.
"""

from abc import abstractmethod
from collections.abc import Sequence
from typing import Any, ClassVar, Self

import numpy as np
from pydantic import Field, model_validator
from scipy.special import chdtrc

from stages.science.plant.effect import FROM_START, Bench, Effect, Signals, Values
from stages.science.plant.effect_config import EffectConfig
from stages.science.plant.record_plant import InitialState, Placed, Positive, RecordPlant, Tries, Watched
from stages.science.signals.filtering import choose_window, differentiate, smooth
from stages.science.signals.trajectories import Array

SITE = "element"
PATH, RATE = "path", "rate"
"""Names of displacement and its rate per second among the signals that an answer is made of; unit of `along`."""
SMOOTHED, CUBIC = 0.15, 3
"""Longest window, paces, and order of the polynomials by which a displacement is differentiated."""
MOMENTS = 16
"""Parts of a session at whose borders fits of what begins at one moment begin."""
FEWEST = 4
"""Paces between samples of a window below which nothing is smoothed."""
PLACES, MOVED = 8, 1e-3
"""Parts of the way in which it is told whether the answer follows what is rough, and the chance below which it does."""
STILL = 1e-9
"""Range of a signal over its largest value, up to which it stands still but for rounding."""


class _ElementEffect(EffectConfig):
    SITE = SITE


class ElementPlant(RecordPlant):
    """Everything that simulating an element takes."""

    SITE: ClassVar[str] = SITE
    ELEMENT: ClassVar[str] = SITE

    along: str = Field(description="signal along which the element is moved")
    against: str | None = Field(None, description="signal that is subtracted from it, as the other of two pressures")
    speed: str | None = Field(None, description="measured rate of it, unit of `along` per s; null = its difference")
    path_window_s: float | None = Field(None, ge=0.0, description="in which it is smoothed, s; null = by its noise")
    rate_window_s: float | None = Field(None, ge=0.0, description="in which its rate is told, s; null = by its noise")
    pressing: list[str | None] = Field([], description="signals with whose mean size friction may grow")
    pressing_scale: Positive | None = Field(None, description="largest mean size of `pressing`, its unit")
    along_middle: float | None = Field(description="value of `along` from which effects count, its unit")
    along_scale: Positive | None = Field(description="way in which effects tell theirs, unit of `along`")
    output_scale: Positive | None = Field(description="answer in which effects tell their sizes, unit of the output")
    time_scale_s: Positive | None = Field(description="time of a usual movement through one scale, s")
    effects: list[_ElementEffect]

    @model_validator(mode="after")
    def _check_names(self) -> Self:
        named = [entry.name for entry in self.effects]
        if len(set(named)) < len(named):
            raise ValueError("effects: expected each name once")
        return self

    @property
    def inputs(self) -> tuple[str, ...]:
        """Signals that the answer is told from, the one along which the element is moved first."""
        return tuple(dict.fromkeys(each for each in (self.along, self.against, self.speed, *self.pressing) if each))

    def find_lacking(self, effect: Effect) -> str:
        """Return what this element lacks for an effect to act, empty where it can.

        What one of the drive or of the displacement does to an element that nothing else drives can hardly be told from
        what the reading's sensor does.
        """
        if getattr(effect, "loaded", False) and not self.pressing:
            return "what presses; name it, as plant.pressing=[p1_kpa]"
        if getattr(effect, "changes", "answer") in ("drive", "displacement") and not self.driving:
            return "a signal that drives it besides its displacement"
        return ""

    @property
    def finest_s(self) -> float:
        """Time between samples, s, below which more of them tell no more."""
        return 0.01 * self.movement_s

    @property
    def movement_s(self) -> float:
        """Time of a movement through one scale, s."""
        return self.time_scale_s or 1.0

    @property
    def driving(self) -> tuple[str, ...]:
        """All inputs but those that tell how it is moved, whose noise is no memory."""
        return tuple(name for name in self.inputs if name not in (self.along, self.against, self.speed))

    @property
    def memory_s(self) -> float:
        """None: it answers at once."""
        return 0.0

    @abstractmethod
    def answer(self, signals: Signals, constants: Values) -> Array:
        """Return what the element would answer without any effect, of the signals' shape."""

    @abstractmethod
    def guess(self, signals: Signals) -> dict[str, tuple[float, float, float, float]]:
        """Return start, bounds and deviation of each constant, from all records one after another, (N,) by name."""

    def list_starts(self, effect: Any, records: Sequence[Signals], step_s: float, constants: Values) -> Tries:
        """Return where fits of an effect that begins at a moment of the session may begin: evenly along it."""
        if not effect.begins_later:
            return super().list_starts(effect, records, step_s, constants)
        paces = sum(len(each[self.output]) for each in records) * step_s / self.know("time_scale_s")
        first = effect.parameters[0]
        return [{first.name: first.starts[0], FROM_START: paces * k / MOMENTS} for k in range(1, MOMENTS)]

    def find_scales(self, records: Sequence[Signals], step_s: float) -> dict[str, float]:
        """Return what scales are if they were left open, told by the signal along which the element is moved."""
        paths = [self.displace(each) for each in records]
        along, answer = np.concatenate(paths), np.concatenate([each[self.output] for each in records])
        if np.ptp(along) <= STILL * np.abs(along).max():
            raise ValueError(
                f"signal {self.along}: expected one along which the element is moved, got {along[0]:.6g} throughout; "
                "name one that changes"
            )
        way = 0.5 * float(np.ptp(along))
        speed = float(np.mean(np.concatenate([np.abs(np.diff(each)) for each in paths]))) / step_s
        time_scale_s = self.time_scale_s or (way / speed if speed > 0.0 else 1.0)
        pressing = {"pressing_scale": max(float(self.press(each).max()) for each in records)} if self.pressing else {}
        return pressing | {
            "along_middle": 0.5 * float(along.max() + along.min()),
            "along_scale": way,
            "output_scale": max(0.5 * float(np.ptp(answer)), 1e-12),
            "time_scale_s": time_scale_s,
            "path_window_s": self._choose_path_window(records, step_s, SMOOTHED * time_scale_s),
            "rate_window_s": choose_window(paths, 1.0 / step_s, SMOOTHED * time_scale_s, CUBIC, 1),
        }

    def _choose_path_window(self, records: Sequence[Signals], step_s: float, longest_s: float) -> float:
        """Return the window in which the displacement is smoothed; 0 where what that takes away moves the answer."""
        paths, answers = [self.displace(each) for each in records], [each[self.output] for each in records]
        window_s = choose_window(paths, 1.0 / step_s, longest_s, CUBIC, 0)
        if window_s < FEWEST * step_s:
            return 0.0
        path = np.concatenate(paths)
        rough, answered = (
            np.concatenate([each - smooth(each[:, None], step_s, window_s)[:, 0] for each in some])
            for some in (paths, answers)
        )
        product = rough * answered
        parts = np.array_split(np.argsort(path), PLACES)  # a law's slope may turn
        squares = sum(product[at].sum() ** 2 / max((product[at] ** 2).sum(), 1e-300) for at in parts)
        return 0.0 if chdtrc(PLACES, squares) < MOVED else window_s

    def simulate(
        self,
        signals: Signals,
        step_s: float,
        start_s: Array,
        constants: Values,
        effects: Sequence[Placed] = (),
        begun: InitialState | None = None,
    ) -> Array:
        """Return the answer, (T, R); see `RecordPlant.simulate`."""
        placed = self.place(effects)
        if not placed:
            return self._answer_checked(signals, constants)
        scale, bench = self.know("output_scale"), self.set_up(signals, step_s, start_s)
        acting = self._move_in_time(signals, bench, placed)
        bench = bench if acting is signals else self.set_up(acting, step_s, start_s)
        answer = self._answer_checked(acting, constants) / scale
        for effect, values in (*_select(placed, "answer"), *_select(placed, "reading")):
            answer = effect.apply(answer, bench, values)
        return answer * scale

    def _answer_checked(self, signals: Signals, constants: Values) -> Array:
        answer, expected = self.answer(signals, constants), signals[self.along].shape
        if np.shape(answer) != expected:
            raise ValueError(
                f"{type(self).__name__}.answer: expected an array of the signals' shape (T, R), {expected}, got "
                f"{np.shape(answer)}"
            )
        return answer

    def _move_in_time(self, signals: Signals, bench: Bench, placed: Sequence[Placed]) -> Signals:
        """Return the signals that act: what drives the element first, then how it is moved, as effects change them."""
        moved = [name for name in (self.along, self.against, self.speed, PATH, RATE) if name and name in signals]
        for changes, names in (("drive", self.driving), ("displacement", moved)):
            for effect, values in _select(placed, changes):
                signals = {**signals, **{name: effect.apply(signals[name], bench, values) for name in names}}
        return signals

    def displace(self, signals: Signals) -> Array:
        """Return the signal along which the element is moved, in its unit."""
        return signals[self.along] - signals[self.against] if self.against else signals[self.along]

    def press(self, signals: Signals) -> Array:
        """Return the mean size of the signals that press."""
        return np.asarray(np.mean([np.abs(signals[name]) for name in self.pressing if name], axis=0))

    def refine(self, signals: Signals, step_s: float) -> Signals:
        """Return signals (T, R) with the displacement, and its rate per second."""
        window_s = self.path_window_s or 0.0
        if window_s >= FEWEST * step_s:
            moved = {name: smooth(signals[name], step_s, window_s) for name in (self.along, self.against) if name}
            signals = {**signals, **moved}
        path = self.displace(signals)
        if self.speed:
            return {**signals, PATH: path, RATE: signals[self.speed]}
        window_s = min(self.rate_window_s or SMOOTHED * self.movement_s, (len(path) - 2) * step_s)
        return {**signals, PATH: path, RATE: differentiate(path, 1.0 / step_s, window_s, CUBIC)}

    def set_up(self, signals: Signals, step_s: float, start_s: Array) -> Bench:
        """Return what effects look at, for signals as `refine` returns them, (T, R)."""
        time_scale_s, along_scale = self.know("time_scale_s"), self.know("along_scale")
        way = np.ascontiguousarray((signals[PATH] - self.know("along_middle")) / along_scale)
        within = np.arange(len(way))[:, None] * step_s
        load = self.press(signals) / self.know("pressing_scale") if self.pressing else np.ones_like(way)
        rate = signals[RATE] * (time_scale_s / along_scale)
        return Bench(way, rate, step_s, time_scale_s, within + start_s, load)

    def watch(self, signals: Signals, step_s: float, constants: Values) -> list[Watched]:
        """Return the inputs, and how the element is moved."""
        refined = self.refine(signals, step_s)
        rate = self.set_up(refined, step_s, np.zeros(1)).rate
        per_s = self.know("along_scale") / self.know("time_scale_s")
        path = f"{self.along} - {self.against}" if self.against else self.along
        others = (Watched(name, signals[name], False) for name in self.inputs if name not in (path, self.speed))
        return [Watched(path, refined[PATH], False), Watched(f"rate of {path}", rate, True, self.along, per_s), *others]


def _select(placed: Sequence[Placed], changes: str) -> list[Placed]:
    return [each for each in placed if getattr(each[0], "changes", "answer") == changes]
