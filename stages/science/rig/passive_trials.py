"""What an automatic protocol commands while nobody moves: one muscle of a joint is swept, the other one resists.

A section of the configuration and a generator flow in; the commands of an experiment's trials flow out.
"""

import numpy as np
from pydantic import Field, PositiveInt

from stages.science.plant.declaration import Declared
from stages.science.plant.exoskeleton import Exoskeleton
from stages.science.rig.excitation import Range, check_ranges
from stages.science.rig.limits import Limits
from stages.science.signals.trajectories import Array, connect_points

STEEPEST = 1.875
"""Largest slope of a minimum-jerk change, over its mean."""


class Sweeps(Declared):
    """Quasi-static trials that cover the pressures of both muscles of a joint against each other.

    In the first trial and in every other one, agonists are swept over their range while antagonists hold levels; in
    the remaining ones it is the other way round. Sweeps go back and forth at a constant rate, so that friction is met
    in both directions; every second pair of trials begins at the top. Each muscle's range is cut into as many equal
    strata as it holds levels in an experiment, and one level is drawn from each (McKay, Beckman and Conover 1979), so
    that an experiment covers the range however the draws fall.
    """

    range_kpa: dict[str, Range] = Field(description="lowest and highest pressure of each muscle, kPa gauge")
    sweeps: PositiveInt = Field(description="one-way sweeps of a trial; 2 = there and back")
    levels: PositiveInt = Field(description="levels that a resisting muscle holds in a trial, one after the other")
    transition_share: float = Field(
        ge=0, le=1, description="share of a level's time that the change to the next takes, 1"
    )

    def check_against(self, exoskeleton: Exoskeleton, path: str) -> None:
        """Check that every joint has muscles that pull against each other, and that a trial has time for its sweeps.

        A `ValueError` names the key, below the path of this section in the configuration.
        """
        check_ranges(self.range_kpa, exoskeleton, f"{path}.range_kpa")
        for joint in exoskeleton.joint_names:
            for role in ("agonist", "antagonist"):
                if not any(muscle.joint == joint and muscle.role == role for muscle in exoskeleton.muscles):
                    raise ValueError(
                        f"{path}: expected muscles that pull against each other on every joint, as nobody else does, "
                        f"got no {role} on joint {joint}; leave the stage out or add the muscle to exoskeleton.muscles"
                    )
        if 2 * self.sweeps > exoskeleton.samples:
            raise ValueError(
                f"{path}.sweeps: expected at most {exoskeleton.samples // 2} in a trial of {exoskeleton.samples} "
                f"samples, so that each has two, got {self.sweeps}; lower it"
            )
        if self.levels > exoskeleton.samples:
            raise ValueError(
                f"{path}.levels: expected at most one for each of a trial's {exoskeleton.samples} samples, "
                f"got {self.levels}; lower it"
            )

    def largest_rate_kpa_per_s(self, muscle: str, exoskeleton: Exoskeleton) -> float:
        """Return a bound on how fast a muscle's command changes, kPa/s; infinite where levels change by steps."""
        span = self.range_kpa[muscle].high - self.range_kpa[muscle].low
        sweeping = self.sweeps * span / exoskeleton.trial_s
        change_s = self.transition_share * exoskeleton.trial_s / self.levels
        if self.levels == 1:
            return sweeping
        return max(sweeping, STEEPEST * span / change_s if change_s else np.inf)

    def check_rates(self, exoskeleton: Exoskeleton, limits: Limits | None, path: str) -> None:
        """Check that a rig with limits applies commands as they are; a `ValueError` names muscle, rate and limit."""
        for muscle in exoskeleton.muscles:
            rate = self.largest_rate_kpa_per_s(muscle.name, exoskeleton)
            if limits and muscle.type in limits and rate > limits[muscle.type].slew_kpa_per_s:
                raise ValueError(
                    f"{path}: expected changes within the {limits[muscle.type].slew_kpa_per_s} kPa/s of "
                    f"rig.limits.{muscle.type}.slew_kpa_per_s, got up to {rate:.4g} kPa/s for {muscle.name}; "
                    f"lower {path}.sweeps or raise {path}.transition_share"
                )

    def draw(self, exoskeleton: Exoskeleton, trials: int, generator: np.random.Generator) -> Array:
        """Draw the pressure commands of one experiment within the ranges, (trials, T, M), kPa gauge."""
        share = np.arange(exoskeleton.samples) / exoskeleton.samples
        up = 1.0 - np.abs((self.sweeps * share) % 2.0 - 1.0)
        commands = np.empty((trials, exoskeleton.samples, len(exoskeleton.muscles)))
        for m, muscle in enumerate(exoskeleton.muscles):
            swept = np.arange(trials) % 2 == (0 if muscle.role == "agonist" else 1)
            count = int((~swept).sum()) * self.levels
            drawn = (generator.permutation(count) + generator.random(count)) / max(count, 1)  # one of each stratum
            levels = drawn.reshape(-1, self.levels)
            held = [self._hold(row, share * exoskeleton.trial_s, exoskeleton.trial_s) for row in levels]
            commands[~swept, :, m] = np.reshape(held, (-1, exoskeleton.samples))
            for k in np.flatnonzero(swept):
                commands[k, :, m] = 1.0 - up if (k // 2) % 2 else up
            span = self.range_kpa[muscle.name]
            commands[:, :, m] = np.clip(span.low + (span.high - span.low) * commands[:, :, m], span.low, span.high)
        return commands

    def _hold(self, levels: Array, time_s: Array, trial_s: float) -> Array:
        """Return the levels over time, each for an equal share of the trial, changes in the middle between two."""
        if self.levels == 1:
            return np.full(len(time_s), levels[0])
        each_s = trial_s / self.levels
        lasting = np.full(self.levels - 1, self.transition_share * each_s)
        return connect_points(levels[:, None], np.arange(1, self.levels) * each_s - lasting / 2, lasting, time_s)[:, 0]
