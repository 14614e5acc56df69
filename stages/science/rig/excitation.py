"""How an experimenter moves freely and how pressures vary meanwhile, and the movements that are recorded so.

A section of the configuration and a generator flow in; commands, trials and measurements come out. Whatever stage
records free movements, or draws levels from the same ranges, checks them here and refuses them in the same words, with
the path of its own section in front.
"""

from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, NonNegativeFloat, NonNegativeInt, PositiveFloat, PositiveInt, model_validator

from stages.science.plant.declaration import Declared, nearest
from stages.science.plant.exoskeleton import Exoskeleton
from stages.science.rig.contract import MOST_ROWS, Rig, Watch, tidy
from stages.science.rig.limits import Limits, ordered
from stages.science.rig.trial import NATURAL, Manner, Proposal, Trial
from stages.science.signals.trajectories import Array, pressure_profiles, reach_postures


class Range(Declared):
    """Lowest and highest value."""

    low: NonNegativeFloat
    high: NonNegativeFloat

    _order = ordered("low", "high", strictly=False)


class Durations(Range):
    """Shortest and longest duration, s; no longer than a trial may be, an hour."""

    high: Annotated[float, Field(ge=0, le=3600)]


class Pressure(Declared):
    """How the robot's pressure commands vary: held levels, joined by smooth changes and by steps."""

    range_kpa: dict[str, Range] = Field(description="lowest and highest level of each muscle, kPa gauge")
    hold_s: Durations = Field(description="how long a level is held, s")
    transition_s: Durations = Field(description="how long a smooth change takes, s")
    step_share: float = Field(ge=0, le=1, description="share of the changes that are steps, 1")

    @property
    def mean_level_s(self) -> float:
        """Mean time from one level to the next, s; steps take none."""
        transition_s = (1 - self.step_share) * (self.transition_s.low + self.transition_s.high) / 2
        return (self.hold_s.low + self.hold_s.high) / 2 + transition_s

    def draw(self, rig: Rig, generator: np.random.Generator) -> Array:
        """Draw each muscle's pressure command (T, M), kPa."""
        ranges = [self.range_kpa[name] for name in rig.muscles]
        low, high = [each.low for each in ranges], [each.high for each in ranges]
        hold_s, transition_s = ((each.low, each.high) for each in (self.hold_s, self.transition_s))
        how = {"hold_s": hold_s, "transition_s": transition_s}
        return pressure_profiles(
            generator, low, high, rig.samples, rig.sampling_rate_hz, **how, step_share=self.step_share
        )


Pattern = Literal["independent", "constant", "together", "opposed"]
"""Of muscles' pressures: each by itself, at their first level, rising and falling together, or antagonists against."""


class MovementKind(Declared):
    """A kind of free movement: how it differs from a natural one, and how many of a set are of it."""

    share: float = Field(gt=0, le=1, description="share of the set's movements, 1")
    range_ratio: float = Field(gt=0, le=2, description="range of postures over that of natural movements, 1")
    duration_ratio: float = Field(ge=0.1, le=100, description="durations of reaches over natural ones, 1")
    rest_ratio: float = Field(ge=0, le=100, description="durations of rests over natural ones, 1")
    pressures: Pattern = Field(description="how muscles' pressures vary")
    instruction: str = Field(min_length=1, description="what the experimenter is told")

    def shape(self, command_kpa: Array, ranges: Sequence[Range], agonists: Sequence[bool]) -> Array:
        """Return a command (T, M) in this kind's pattern, from one that varies by itself in each muscle's range.

        ``together`` and ``opposed`` muscles follow the first one: in the second case, antagonists where it falls.
        """
        if self.pressures == "constant":
            return np.repeat(command_kpa[:1], len(command_kpa), axis=0)
        if self.pressures == "independent":
            return command_kpa
        low, high = np.array([(each.low, each.high) for each in ranges]).T
        share = (command_kpa[:, :1] - low[0]) / max(high[0] - low[0], np.finfo(float).tiny)
        opposed = np.array(agonists) != agonists[0] if self.pressures == "opposed" else np.zeros(len(low), dtype=bool)
        return np.asarray(low + (high - low) * np.where(opposed, 1.0 - share, share))


NATURAL_KIND = MovementKind(share=1.0, pressures="independent", instruction="a natural movement", **vars(NATURAL))


class FreeMovements(Declared):
    """A set of free movements to record, natural ones where no kinds are given."""

    seed: NonNegativeInt
    trajectories: PositiveInt
    kinds: dict[str, MovementKind] | None
    pressure: Pressure

    @model_validator(mode="after")
    def _share_all(self) -> Self:
        shares = sum(each.share for each in self.all_kinds.values())
        if abs(shares - 1.0) > 1e-9:
            raise ValueError(f"kinds: expected shares that add up to 1, got {shares:.6g}; change one of them")
        return self

    @property
    def all_kinds(self) -> Mapping[str, MovementKind]:
        """The kinds by name, natural movements where none are given."""
        return self.kinds or {"natural": NATURAL_KIND}

    def find_kind(self, trajectory: int) -> MovementKind:
        """Return the kind of a movement: kinds alternate so that any first part of the set has their shares."""
        shares = {name: each.share for name, each in self.all_kinds.items()}
        counts = dict.fromkeys(shares, 0)
        name = ""
        for position in range(trajectory + 1):
            name = max(shares, key=lambda each: shares[each] * (position + 1) - counts[each])
            counts[name] += 1
        return self.all_kinds[name]

    def check_against(self, exoskeleton: Exoskeleton, path: str, limits: Limits | None = None) -> None:
        """Check that the machine has these muscles, samples and permits these levels and that memory holds recordings.

        `limits` are as of `check_levels`.

        A `ValueError` names the key, below the path of this section in the configuration.
        """
        check_ranges(self.pressure.range_kpa, exoskeleton, f"{path}.pressure.range_kpa")
        sample_s, level_s = 1 / exoskeleton.sampling_rate_hz, self.pressure.mean_level_s
        if level_s < sample_s:
            raise ValueError(
                f"{path}.pressure.hold_s: expected levels that, with transition_s, last a sample ({sample_s:.3g} s) on "
                f"average, got {level_s:.3g} s; raise {path}.pressure.hold_s.high or {path}.pressure.transition_s.high"
            )
        most = MOST_ROWS // (exoskeleton.samples * len(exoskeleton.muscles))
        if self.trajectories > most:
            raise ValueError(
                f"{path}.trajectories: expected at most {most} movements of {exoskeleton.samples} samples and "
                f"{len(exoskeleton.muscles)} muscles, as {MOST_ROWS} rows still fit in memory, "
                f"got {self.trajectories}; lower it, exoskeleton.trial_s or exoskeleton.sampling_rate_hz"
            )
        check_levels(self.pressure.range_kpa, exoskeleton, limits, f"{path}.pressure.range_kpa")

    def record(
        self,
        trajectory: int,
        rig: Rig,
        generator: np.random.Generator,
        label: str,
        watch: Watch | None = None,
        number: int | None = None,
        proposal: Proposal | None = None,
    ) -> dict[str, NDArray[Any]]:
        """Record one movement of the experimenter under pressures drawn for it, by `Rig.execute` of a connected rig.

        Returned are its number, as ``trajectory``, and the columns of `RECORDING_COLUMNS` (M T,).
        """
        kind, muscles = self.find_kind(trajectory), rig.exoskeleton.muscles
        ranges = [self.pressure.range_kpa[each.name] for each in muscles]
        agonists = [each.role == "agonist" for each in muscles]
        command = kind.shape(self.pressure.draw(rig, generator), ranges, agonists)
        manner = Manner(kind.range_ratio, kind.duration_ratio, kind.rest_ratio)
        trial = Trial("free", "experimenter", command, None, label, number, proposal, manner)
        columns = tidy(rig.execute(trial, generator, watch), rig)
        return {"trajectory": np.full(len(columns["time_s"]), trajectory), **columns}


class RigWithLimits(Declared, extra="ignore"):
    """The rig's limits on commands, where it has them; its other keys are passed over."""

    limits: Limits | None = None


def check_ranges(ranges: Mapping[str, Range], exoskeleton: Exoskeleton, path: str) -> None:
    """Check that every muscle has a range, kPa gauge, that no other has one, and that every muscle may pull.

    A `ValueError` names the muscle, below the path of the ranges in the configuration.
    """
    names = exoskeleton.muscle_names
    missing = [name for name in names if name not in ranges]
    if missing:
        raise ValueError(f"{path}: expected a range for every muscle, none for {', '.join(missing)}")
    for name, levels in ranges.items():
        if name not in names:
            raise ValueError(f"{path}: no muscle '{name}'; {nearest(name, names)}")
        if levels.high == 0:
            raise ValueError(
                f"{path}.{name}.high: expected more than 0, as a vented muscle does not pull, got 0; raise it"
            )


def check_levels(ranges: Mapping[str, Range], exoskeleton: Exoskeleton, limits: Limits | None, path: str) -> None:
    """Check that every pressure level that may be drawn is one that the muscle may be commanded.

    A rig applies the nearest command that it permits, so that levels beyond its limits would all be one level. Where
    it has no limits, the muscles' largest pressures count. A `ValueError` names the level, below the path of the ranges
    in the configuration, and the limit.
    """
    for muscle in exoskeleton.muscles:
        limit = (limits or {}).get(muscle.type)
        low, high = (limit.low_kpa, limit.high_kpa) if limit else (0.0, muscle.max_pressure_kpa)
        levels = ranges[muscle.name]
        source = f"rig.limits.{muscle.type}" if limit else f"max_pressure_kpa of {muscle.name}"
        its = f"{path}.{muscle.name}"
        if levels.low < low:
            raise ValueError(
                f"{its}.low: expected at least the {low} kPa of {source}.low_kpa, got {levels.low}; raise it"
            )
        if levels.high > high:
            source = f"{source}.high_kpa" if limit else source
            raise ValueError(f"{its}.high: expected at most the {high} kPa of {source}, got {levels.high}; lower it")


class Movement(Declared):
    """How an experimenter moves when nothing is asked of them: reaches between random postures, with rests."""

    shortest_move_s: PositiveFloat = Field(description="quickest reach, s")
    longest_move_s: PositiveFloat = Field(description="slowest reach, s")
    shortest_rest_s: float = Field(ge=0.0, description="shortest rest, s")
    longest_rest_s: float = Field(ge=0.0, description="longest rest, s")
    range_share: float = Field(gt=0.0, le=1.0, description="share of the joint's range that postures span, 1")

    _moves = ordered("shortest_move_s", "longest_move_s", strictly=False)
    _rests = ordered("shortest_rest_s", "longest_rest_s", strictly=False)


def move_freely(
    movement: Movement,
    exoskeleton: Exoskeleton,
    samples: int,
    generator: np.random.Generator,
    manner: Manner = NATURAL,
) -> Array:
    """Draw a movement of all joints, (samples, J), rad: a natural one, or one in another manner.

    A smaller one lies about a posture that is drawn within the natural range; a wider one about the middle of the
    joint's range, and ends with that.
    """
    lower, upper = np.array([(joint.lower_rad, joint.upper_rad) for joint in exoskeleton.joints]).T
    margin = 0.5 * (1.0 - movement.range_share) * (upper - lower)
    low, high = lower + margin, upper - margin
    if manner.range_ratio < 1.0:
        half = 0.5 * manner.range_ratio * (high - low)
        centre = generator.uniform(low + half, high - half)
        low, high = centre - half, centre + half
    elif manner.range_ratio > 1.0:
        wider = 0.5 * (manner.range_ratio - 1.0) * (high - low)
        low, high = np.maximum(low - wider, lower), np.minimum(high + wider, upper)
    move_s = (manner.duration_ratio * movement.shortest_move_s, manner.duration_ratio * movement.longest_move_s)
    rest_s = (manner.rest_ratio * movement.shortest_rest_s, manner.rest_ratio * movement.longest_rest_s)
    return reach_postures(generator, low, high, samples, exoskeleton.sampling_rate_hz, move_s, rest_s)
