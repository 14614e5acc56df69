"""Constants of the models' memory by the designed trials: identified with the hyperparameters, and what that takes off.

In: `points` of the design's arm, the recordings of the executed trials, `bank` and `candidates` for the inputs' scales,
`hyperprior` and `scaling`; to test on, `task_movements`, `bank` and `unseen_bank`, whose force the evaluation alone
reads. Out: `input_constants`, `constants_tried`, `constants_errors`, and a sentence. It chooses and measures nothing.
"""

from typing import Annotated, ClassVar, Self

import pandas as pd
from pydantic import Field, PositiveFloat, PositiveInt, model_validator

from pipeline.config import Section, View
from pipeline.context import Context
from pipeline.stage import stage
from pipeline.table import Table, column, sentences
from stages.science.figures.input_constants import draw_constants
from stages.science.muscle_models.error_rates import ALL_MUSCLES, average_muscles
from stages.science.muscle_models.input_constants import Evidence, Fitted, Identified, identify_constants
from stages.science.muscle_models.inputs import InputConstants, ModelSettings
from stages.science.muscle_models.muscle_set import RecordedModels
from stages.science.muscle_models.samples import gather_tests, keep_wanted, locate_points
from stages.science.recording.datasets import join_executed
from stages.science.signals.measures import error_rate
from stages.science.signals.scaling import MODEL_OUTPUT

WHO = ["participant", "experiment"]
WORDS = {"task": "the task", "bank": "the bank", "unseen_bank": "movements that nothing else saw"}
CONSTANTS = InputConstants.model_fields
VALUES = {name: column(float, str(each.description), low=0) for name, each in CONSTANTS.items()}

INPUT_CONSTANTS = Table(
    "input_constants",
    "A constant of the models' memory",
    {
        "constant": column(str, "as in model.constants", among=list(CONSTANTS)),
        "assumed": column(float, "as configured, in the unit that model.constants tells", low=0),
        "identified": column(float, "where the posterior of all muscles' models is highest, in the same unit", low=0),
        "octaves": column(float, "the second over the first, as a power of two"),
    },
    key=("constant",),
)
CONSTANTS_TRIED = Table(
    "constants_tried",
    "A set of constants that was tried",
    {
        **VALUES,
        "score": column(
            float, "log posteriors of all models, each at its maximum, and the constants' log prior (nats)"
        ),
    },
    key=(*VALUES,),
)
CONSTANTS_ERRORS = Table(
    "constants_errors",
    "Error rate of the models of one experiment with the assumed constants, and with those identified",
    {
        "participant": column(str, "who tracked"),
        "experiment": column(int, "experiment of this participant", low=1),
        "tested_on": column(str, "; ".join(f"{name}: {told}" for name, told in WORDS.items()), among=list(WORDS)),
        "muscle": column(str, "muscle, or mean for the average over muscles"),
        "assumed": column(float, "RMSE of the force over the largest of the test data", percent=True, low=0),
        "identified": column(float, "the same with the identified constants", percent=True, low=0),
    },
    key=(*WHO, "tested_on", "muscle"),
    main=("muscle", ALL_MUSCLES),
)
CONSTANTS_FINDINGS = sentences("constants_findings", "finding")


class ConstantsSettings(Section):
    """Config group ``input_constants``."""

    experiments: PositiveInt
    spread_octaves: PositiveFloat
    steps_octaves: Annotated[list[PositiveFloat], Field(min_length=1)]
    starts: Annotated[int, Field(ge=0, le=1000)]


class Remembers(View):
    """The models have an input with a constant."""

    model: ModelSettings

    @model_validator(mode="after")
    def _name_a_constant(self) -> Self:
        if not self.model.constant_names:
            raise ValueError(
                f"model.inputs: expected one with a constant to identify, got {', '.join(self.model.inputs)}; set "
                "model=memory, or leave input_constants out of workflow.stages"
            )
        return self


class Config(Section):
    """What this stage reads."""

    checks: ClassVar = (Remembers,)

    input_constants: ConstantsSettings
    model: ModelSettings
    seed: int


@stage(INPUT_CONSTANTS, CONSTANTS_TRIED, CONSTANTS_ERRORS, CONSTANTS_FINDINGS, stream="input_constants")
def input_constants(
    cfg: Config,
    bank: pd.DataFrame,
    candidates: pd.DataFrame,
    hyperprior: pd.DataFrame,
    scaling: pd.DataFrame,
    points: pd.DataFrame,
    hardware_recordings: pd.DataFrame,
    active_recordings: pd.DataFrame,
    ctx: Context,
    task_movements: pd.DataFrame | None = None,
    unseen_bank: pd.DataFrame | None = None,
) -> dict[str, pd.DataFrame]:
    """Identify the constants of the models' inputs, and compare the models with those that were assumed."""
    settings, own = cfg.input_constants, points[points["arm"] == points["arm"].iloc[0]]
    initial, designed, own = (
        each[each["experiment"] <= settings.experiments] for each in (hardware_recordings, active_recordings, own)
    )
    executed = join_executed(initial, designed)
    placed = locate_points(own, initial, designed, {"row": executed.index.to_numpy()})
    keyed = placed.groupby([*WHO, "muscle"], sort=False)
    rows = {(str(key[0]), int(str(key[1])), str(key[2])): its["row"].to_numpy() for key, its in keyed}
    recorded = {str(name): RecordedModels.read(hyperprior, scaling, name) for name in hyperprior["muscle"].unique()}
    evidence = Evidence(cfg.model, bank, candidates["time_s"].unique(), executed, rows, recorded)
    search = settings.spread_octaves, settings.steps_octaves, settings.starts, ctx.generator("starts")
    names = cfg.model.constant_names
    with ctx.progress("sets of constants", 6 * len(names) + 1) as advance:
        found = identify_constants(
            evidence, *search, lambda each: advance(f"octaves {', '.join(map('{:g}'.format, each))}")
        )
    given = {"task": task_movements, "bank": bank, "unseen_bank": unseen_bank}
    errors = compare_errors(cfg.model, found, given)
    constants = tabulate_constants(cfg.model, found)
    tried = pd.DataFrame(
        [{**cfg.model.scale(octaves).constants.model_dump(), "score": score} for octaves, score in found.scores.items()]
    )
    ctx.figure(
        "input_constants",
        draw_constants(tried, constants),
        "Score of the sets of constants that were tried: the log posteriors of all muscles' models, each at its "
        "maximum, with the log prior of the constants. Filled: sets that differ from the best in this constant alone.",
    )
    told = pd.DataFrame({"sentence": describe_constants(constants, errors, found)})
    kept = (constants, tried, errors[list(CONSTANTS_ERRORS.columns)], told)
    return dict(zip([each.name for each in input_constants.writes], kept, strict=True))


def tabulate_constants(model: ModelSettings, found: Identified) -> pd.DataFrame:
    """Return the rows of `input_constants`."""
    best = model.scale(found.best).constants
    rows = [
        (name, getattr(model.constants, name), getattr(best, name), octaves)
        for name, octaves in zip(model.constant_names, found.best, strict=True)
    ]
    return pd.DataFrame(rows, columns=list(INPUT_CONSTANTS.columns))


def compare_errors(model: ModelSettings, found: Identified, given: dict[str, pd.DataFrame | None]) -> pd.DataFrame:
    """Return the rows of `constants_errors` on the test sets that there are, the average over muscles among them."""
    both = {"assumed": (model, found.assumed), "identified": (model.scale(found.best), found.fitted)}
    rates: dict[tuple[str, int, str, str], dict[str, float]] = {}
    for name, (own, models) in both.items():
        for tested_on, samples in gather_tests(own, given).items():
            by_muscle = dict(list(keep_wanted(samples).groupby("muscle")))
            for (participant, experiment, muscle), fitted in models.items():
                rate = measure_error(fitted, by_muscle[muscle])
                rates.setdefault((participant, experiment, tested_on, muscle), {})[name] = rate
    keys = [*WHO, "tested_on", "muscle"]
    errors = pd.DataFrame([{**dict(zip(keys, where, strict=True)), **each} for where, each in rates.items()])
    return pd.concat([errors, average_muscles(errors, [*both])], ignore_index=True)


def measure_error(fitted: Fitted, samples: pd.DataFrame) -> float:
    """Return the error rate of a muscle's model on a test set."""
    force = fitted.scaling.restore_force(fitted.model.predict_mean(fitted.scaling.inputs_of(samples)))
    return error_rate(force, samples[MODEL_OUTPUT].to_numpy())


def describe_constants(constants: pd.DataFrame, errors: pd.DataFrame, found: Identified) -> list[str]:
    """Return which constants the designed trials speak for, and what the models err by with them."""
    moved = constants[constants["octaves"] != 0.0].to_dict("records")
    if not moved:
        kept = ", ".join(f"{row['constant']} {row['assumed']:.3g}" for row in constants.to_dict("records"))
        return [f"The designed trials speak for no other constants of the models' memory than those assumed ({kept})."]
    mean = errors[errors["muscle"] == ALL_MUSCLES].groupby("tested_on", sort=False)[["assumed", "identified"]].mean()
    rates = [
        f"{_percent(now)} on {WORDS[name]} ({_percent(before)})" for name, before, now in mean.itertuples(name=None)
    ]
    what = " and ".join(f"{row['constant']} {row['identified']:.3g} instead of {row['assumed']:.3g}" for row in moved)
    gain = found.scores[found.best] - next(iter(found.scores.values()))
    keys = " ".join(f"model.constants.{row['constant']}={row['identified']:.4g}" for row in moved)
    return [
        f"The designed trials speak for {what} in the models' memory (log posterior +{gain:.3g}). With these the "
        f"models of the same trials err by {', '.join(rates)}; in brackets with those assumed.",
        f"To design trials with them, add {keys}.",
    ]


def _percent(rate: float) -> str:
    return f"{100 * rate:.3g} %"
