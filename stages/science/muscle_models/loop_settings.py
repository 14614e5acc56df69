"""How Algorithm 1 is set: the section ``active_loop``, and ``loop`` of the analyses where recordings stand for a rig.

Values of the configuration flow in; a `Design` of the GP's flows out.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self, get_args

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    PositiveInt,
    ValidatorFunctionWrapHandler,
    WrapValidator,
    model_validator,
)

from stages.science.gp.interaction import Design
from stages.science.gp.scoring import JOINT
from stages.science.gp.task_utilities import TASK_UTILITIES
from stages.science.gp.utilities import UTILITIES
from stages.science.gp.utility_names import TRIED, load_utility, name_utility

MOST_POINTS = 2000
"""Points of an exact GP, beyond which its covariance (8 N^2 bytes, 32 MB) and the N^3 / 3 operations of each of the
thousands of steps in which hyperparameters are sought take a day for each trial of each arm."""

if TYPE_CHECKING:
    NamedForSamples = str
    Named = str
else:
    NamedForSamples = Literal[*UTILITIES, *TASK_UTILITIES, "random"]
    Named = Literal[NamedForSamples, JOINT]


def _read_own(value: Any, read: ValidatorFunctionWrapHandler) -> Any:
    """Return a utility's name, or the dotted path of ``{_target_: package.module.function}``, tried on a few points."""
    if not isinstance(value, Mapping):
        return read(value)
    path = value.get("_target_")
    if set(value) != {"_target_"} or not isinstance(path, str):
        raise ValueError(f"expected {{_target_: package.module.function}} and no other key, got {dict(value)!r}")
    if name_utility(path) in get_args(Named):
        raise ValueError(f"_target_: {path} has the name of a utility that there is; rename the function")
    try:
        load_utility(path)(TRIED)
    except ValueError as error:
        raise ValueError(f"_target_: {error}") from None
    return path


Utility = Annotated[Named, WrapValidator(_read_own)]
SampleUtility = Annotated[NamedForSamples, WrapValidator(_read_own)]
"""Names, and functions of one's own, which are their dotted paths once they are read."""

Points = Annotated[int, Field(ge=1, le=MOST_POINTS)]


class Movements(BaseModel, extra="ignore", frozen=True, strict=True, allow_inf_nan=False):
    """How many movements the bank will hold; its other keys are passed over."""

    trajectories: int


class DesignSettings(BaseModel):
    """Trials, points and the choices of a `Design`; all required, none unknown.

    Trials and points are bounded by what an exact GP can hold, ``starts`` by the maxima that a posterior of six
    hyperparameters can have, ``memory_mb`` by a terabyte.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)

    utility: Utility
    subsample_utility: SampleUtility
    trials: Annotated[int, Field(gt=0, le=MOST_POINTS)]
    initial_points: Points
    points_per_trial: Points
    reduce: Literal["sum", "max"]
    reuse_trajectories: bool
    joint_every: PositiveInt
    starts: Annotated[int, Field(ge=0, le=1000)]
    memory_mb: Annotated[float, Field(gt=0, le=2**20)]

    @model_validator(mode="after")
    def _keep_the_gp_exact(self) -> Self:
        points = self.initial_points + self.trials * self.points_per_trial
        if points > MOST_POINTS:
            raise ValueError(
                f"points_per_trial: expected at most {MOST_POINTS} points in the end (initial_points + trials x "
                f"points_per_trial), beyond which an exact GP takes days, got {self.initial_points} + {self.trials} x "
                f"{self.points_per_trial} = {points}; lower one of them"
            )
        return self

    def design(self, mean: str, utility: str | None = None) -> Design:
        """Return the choices, with the models' mean (``zero`` or ``constant``), and another utility if given."""
        told = {name: value for name, value in vars(self).items() if name in {each.name for each in fields(Design)}}
        return Design(**{**told, "mean": mean, "utility": utility or self.utility})


class LoopSettings(DesignSettings):
    """The same where recordings stand for a rig, with the initial trials that are drawn from them."""

    initial_trials: PositiveInt

    def check_against(self, section: str, movements: int, samples: int) -> Self:
        """Return the settings of a section if a bank of so many movements, of so many samples each, can serve them.

        A `ValueError` tells a choice that asks for a task, a bank of too few movements for all trials, and a trial of
        too few samples for what is taken from it.
        """
        for key in ("utility", "subsample_utility"):
            chosen = getattr(self, key)
            if chosen in TASK_UTILITIES:
                raise ValueError(
                    f"{section}.loop.{key}: expected a choice that asks for no task, got {chosen}, which "
                    f"the main job alone has; set {section}.loop.{key}=y_y"
                )
        spare, initial = movements - self.initial_trials, self.initial_trials * samples
        if spare < (0 if self.reuse_trajectories else self.trials):
            raise ValueError(
                f"{section}.loop.trials: expected at most {max(spare, 0)} ({movements} movements of the bank less "
                f"{self.initial_trials} initial trials), got {self.trials}; raise bank.trajectories or lower "
                f"{section}.loop.initial_trials"
            )
        for name, most, whose in (
            ("points_per_trial", samples, "a trial"),
            ("initial_points", initial, f"the {self.initial_trials} initial trials"),
        ):
            if getattr(self, name) > most:
                raise ValueError(
                    f"{section}.loop.{name}: expected at most the {most} samples of {whose}, "
                    f"got {getattr(self, name)}; lower it"
                )
        return self


def refuse_repeats(controls: Sequence[str], section: str) -> None:
    """Raise a `ValueError` where one of a loop's controls is there twice."""
    for name, times in Counter(controls).items():
        if times > 1:
            told = [f"{{_target_: {each}}}" if "." in each else each for each in dict.fromkeys(controls)]
            once = f"set {section}.controls=[{','.join(told)}]"
            raise ValueError(f"controls: expected each control once, got {name} {times} times; {once}")
