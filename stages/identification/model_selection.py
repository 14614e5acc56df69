"""Inputs of the models and constants of their memory by the designed trials, and what that takes off their errors.

In: `points` and `models` of the design's arm, the recordings of the executed trials, `bank` and `candidates` for the
inputs' scales, `hyperprior` and `scaling`; to test on, `task_movements`, `bank` and `unseen_bank`, whose force the
evaluation alone reads. Out: `selected_inputs`, `selected_constants`, `models_tried`, `selection_errors`, and in words
`selection_findings` and `selection_advice`. It measures nothing, and trials that were chosen stay.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Annotated, Any

import pandas as pd
from numpy.typing import NDArray
from pydantic import Field, NonNegativeFloat, PositiveFloat, PositiveInt

from pipeline.config import Section
from pipeline.context import Context
from pipeline.printing import format_count
from pipeline.stage import stage
from pipeline.table import Table, column, sentences
from stages.science.figures.model_selection import draw_selection
from stages.science.muscle_models.error_rates import ALL_MUSCLES, TEST_WORDS, average_muscles
from stages.science.muscle_models.inputs import FEATURES, ModelSettings
from stages.science.muscle_models.model_selection import (
    CONSTANTS,
    MOST_OCTAVES,
    Evidence,
    Fitted,
    Key,
    Selected,
    select_model,
)
from stages.science.muscle_models.muscle_set import WHO, RecordedModels
from stages.science.muscle_models.samples import gather_tests, keep_wanted, locate_points
from stages.science.signals.executed_trials import join_executed
from stages.science.signals.measures import error_rate
from stages.science.signals.scaling import MODEL_INPUTS, MODEL_OUTPUT

SIGNALS = ["muscle", "time_s", *MODEL_INPUTS]
SELECTED_INPUTS = Table(
    "selected_inputs",
    "An input of the models that is not measured: whether it is selected, and how much evidence decides so",
    {
        "input": column(str, "as in model.inputs", among=[name for name, each in FEATURES.items() if each.follow]),
        "assumed": column(bool, "whether the designed trials' models have it"),
        "selected": column(bool, "whether the models with most evidence have it"),
        "evidence": column(float, "for selected as it is: log evidence lost by the other decision (nats)", low=0),
    },
    key=("input",),
)
SELECTED_CONSTANTS = Table(
    "selected_constants",
    "A constant that inputs of the models depend on",
    {
        "constant": column(str, "as in model.constants", among=list(CONSTANTS)),
        "assumed": column(float, "as configured, in the unit that model.constants tells", low=0),
        "selected": column(float, "with most evidence, in the same unit", low=0),
        "octaves": column(float, "how often assumed is doubled to give selected: 0 the same, 1 twice, -1 half"),
    },
    key=("constant",),
)
MODELS_TRIED = Table(
    "models_tried",
    "A choice of inputs and constants that was tried",
    {
        "inputs": column(str, "that the models have, by comma"),
        **{name: column(float, "constant, in the unit that model.constants tells", low=0) for name in CONSTANTS},
        "score": column(float, "log evidence of all models and log prior of the constants (nats)"),
    },
    key=("inputs", *CONSTANTS),
)
SELECTION_ERRORS = Table(
    "selection_errors",
    "Error rate of the models of one experiment as they were assumed, and of those with most evidence",
    {
        "participant": column(str, "who tracked"),
        "experiment": column(int, "experiment of this participant", low=1),
        "tested_on": column(
            str, "; ".join(f"{name}: {told}" for name, told in TEST_WORDS.items()), among=list(TEST_WORDS)
        ),
        "muscle": column(str, "muscle, or mean for the average over muscles"),
        "assumed": column(float, "RMSE of the force over the largest of the test data", percent=True, low=0),
        "selected": column(float, "the same with the selected inputs and constants", percent=True, low=0),
    },
    key=(*WHO, "tested_on", "muscle"),
    main=("muscle", ALL_MUSCLES),
)
SELECTION_FINDINGS = sentences("selection_findings", "finding")
SELECTION_ADVICE = sentences("selection_advice", "advice")


class SelectionSettings(Section):
    """Config group ``model_selection``."""

    experiments: PositiveInt
    points_per_trial: PositiveInt
    spread_octaves: PositiveFloat
    steps_octaves: Annotated[list[Annotated[float, Field(gt=0, le=MOST_OCTAVES)]], Field(min_length=1)]
    least_gain_nats: NonNegativeFloat
    log_length_mean: float
    log_length_variance: PositiveFloat


class Config(Section):
    """What this stage reads."""

    model_selection: SelectionSettings
    model: ModelSettings
    seed: int


@stage(
    SELECTED_INPUTS,
    SELECTED_CONSTANTS,
    MODELS_TRIED,
    SELECTION_ERRORS,
    SELECTION_FINDINGS,
    SELECTION_ADVICE,
    stream="model_selection",
)
def model_selection(
    cfg: Config,
    bank: pd.DataFrame,
    candidates: pd.DataFrame,
    hyperprior: pd.DataFrame,
    scaling: pd.DataFrame,
    points: pd.DataFrame,
    models: pd.DataFrame,
    hardware_recordings: pd.DataFrame,
    active_recordings: pd.DataFrame,
    ctx: Context,
    task_movements: pd.DataFrame | None = None,
    unseen_bank: pd.DataFrame | None = None,
) -> dict[str, pd.DataFrame]:
    """Select inputs and constants of the models, and compare the models with those that were assumed."""
    settings, own = cfg.model_selection, points[points["arm"] == points["arm"].iloc[0]]
    initial, designed, own = (
        each[each["experiment"] <= settings.experiments] for each in (hardware_recordings, active_recordings, own)
    )
    executed = join_executed(initial, designed)
    placed = locate_points(own, initial, designed, {"row": executed.index.to_numpy()})
    rows, few = (split(each, "row") for each in (placed, placed[placed["pick"] < settings.points_per_trial]))
    recorded = {str(name): RecordedModels.read(hyperprior, scaling, name) for name in hyperprior["muscle"].unique()}
    length = settings.log_length_mean, settings.log_length_variance
    along, trials = bank[["trajectory", *SIGNALS]], executed[["trial", *SIGNALS, MODEL_OUTPUT]]
    chosen = models[models["arm"] == points["arm"].iloc[0]]
    last = split(chosen[chosen["trial"] == chosen.groupby(WHO)["trial"].transform("max")], "value")
    evidence = Evidence(cfg.model, along, candidates["time_s"].unique(), trials, few, recorded, length, last)
    search = settings.spread_octaves, sorted(settings.steps_octaves, reverse=True), ctx.generator("starts")
    with ctx.progress("choices of inputs and constants", 4 * len(FEATURES)) as advance:
        found = select_model(evidence, *search, lambda each: advance(f"{len(each.inputs)} inputs"), ctx.spread)
    found = found.refit(replace(evidence, rows=rows), ctx.generator("starts"))
    errors = compare_errors(cfg.model, found, {"task": task_movements, "bank": bank, "unseen_bank": unseen_bank})
    constants, inputs = tabulate_constants(cfg.model, found), tabulate_inputs(found)
    tried = [
        {"inputs": ",".join(choice.inputs), **choice.apply(cfg.model).constants.model_dump(), "score": score}
        for choice, score in found.scores.items()
    ]
    ctx.figure(
        "model_selection",
        draw_selection(inputs),
        "Log evidence that is lost where one input is added or left out against the selection, all models together.",
    )
    told = {
        SELECTED_INPUTS.name: inputs,
        SELECTED_CONSTANTS.name: constants,
        MODELS_TRIED.name: pd.DataFrame(tried)[list(MODELS_TRIED.columns)],
        SELECTION_ERRORS.name: errors[list(SELECTION_ERRORS.columns)],
    }
    of = "the same trials"
    if settings.experiments < points["experiment"].max():
        first = "experiment" if settings.experiments == 1 else format_count(settings.experiments, "experiment")
        of += f" of the first {first} of each participant"
    sure = found.gain >= settings.least_gain_nats
    said = {
        SELECTION_FINDINGS.name: describe_selection(inputs, constants, errors, found, of, sure),
        SELECTION_ADVICE.name: advise(constants, found) if sure and is_better(errors) else [],
    }
    return {**told, **{name: pd.DataFrame({"sentence": each}, dtype=object) for name, each in said.items()}}


def split(frame: pd.DataFrame, column: str) -> dict[Key, NDArray[Any]]:
    """Return the values of a column that belong to each model."""
    keyed = frame.groupby([*WHO, "muscle"], sort=False)[column]
    return {(str(key[0]), int(str(key[1])), str(key[2])): its.to_numpy() for key, its in keyed}


def tabulate_inputs(found: Selected) -> pd.DataFrame:
    """Return the rows of `selected_inputs`."""
    rows = [
        (name, name in found.first.inputs, name in found.best.inputs, found.scores[found.best] - found.scores[toggled])
        for name, toggled in found.best.list_toggles()
    ]
    return pd.DataFrame(rows, columns=list(SELECTED_INPUTS.columns))


def tabulate_constants(model: ModelSettings, found: Selected) -> pd.DataFrame:
    """Return the rows of `selected_constants`, of constants that the selected inputs depend on."""
    best, octaves = found.best.apply(model).constants, dict(zip(CONSTANTS, found.best.octaves, strict=True))
    rows = [
        (name, getattr(model.constants, name), getattr(best, name), octaves[name])
        for name in CONSTANTS
        if name in found.best.used
    ]
    return pd.DataFrame(rows, columns=list(SELECTED_CONSTANTS.columns))


def compare_errors(model: ModelSettings, found: Selected, given: Mapping[str, pd.DataFrame | None]) -> pd.DataFrame:
    """Return the rows of `selection_errors` on the test sets that there are, the average over muscles among them."""
    both = {"assumed": (found.first, found.assumed), "selected": (found.best, found.fitted)}
    rates: dict[tuple[str, int, str, str], dict[str, float]] = {}
    for name, (choice, models) in both.items():
        for tested_on, samples in gather_tests(choice.apply(model), given).items():
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


def describe_selection(
    inputs: pd.DataFrame, constants: pd.DataFrame, errors: pd.DataFrame, found: Selected, of: str, sure: bool
) -> list[str]:
    """Return which inputs and constants the designed trials are evidence for, and what models `of` trials err by."""
    added, left = (
        inputs.query(f"selected == {each} and assumed != {each}")["input"].tolist() for each in (True, False)
    )
    moved = constants[constants["octaves"] != 0.0].to_dict("records")
    if not added and not left and not moved:
        return ["The designed trials are evidence for the inputs and constants of the models as they were assumed."]
    changes = [f"also {', '.join(added)}"] if added else []
    changes += [f"without {', '.join(left)}"] if left else []
    changes += [
        f"{row['constant']} {row['selected']:.3g} instead of {row['assumed']:.3g}"
        f"{' (the farthest that is tried)' * (abs(row['octaves']) == MOST_OCTAVES)}"
        for row in moved
    ]
    rates = [
        f"{100 * now:.3g} % instead of {100 * before:.3g} % on {TEST_WORDS[str(name)]}"
        for name, before, now in average_errors(errors).itertuples(name=None)
    ]
    with_these = f"{'; '.join(changes)} (log evidence +{found.gain:,.1f})"
    err = f"the models of {of} err by {', '.join(rates)}"
    if sure and is_better(errors):
        return [f"The designed trials are evidence for other inputs or constants: {with_these}. With these {err}."]
    but = "errors do not fall both on the task and over all test sets" if sure else "that is too little evidence"
    return [
        f"Keep the inputs and constants of the models as they were assumed. Others fit the designed trials better, but "
        f"{but}: {with_these}. With these {err}."
    ]


def average_errors(errors: pd.DataFrame) -> pd.DataFrame:
    """Return the columns `assumed` and `selected` of each test set, averaged over muscles and experiments."""
    means = errors[errors["muscle"] == ALL_MUSCLES].groupby("tested_on", sort=False)
    return means[["assumed", "selected"]].mean()


def is_better(errors: pd.DataFrame) -> bool:
    """Return whether the selected models err less on average over the test sets, and not more on the task."""
    each = average_errors(errors)
    mean, task = each.mean(), each.reindex(["task"]).iloc[0]
    return bool(mean["selected"] < mean["assumed"] and not task["selected"] > task["assumed"])


def advise(constants: pd.DataFrame, found: Selected) -> list[str]:
    """Return how to design trials with what was selected, where that is not what was assumed."""
    keys = [] if found.best.inputs == found.first.inputs else [f"'model.inputs=[{','.join(found.best.inputs)}]'"]
    moved = constants[constants["octaves"] != 0.0]
    keys += [
        f"model.constants.{name}={value:.4g}" for name, value in zip(moved["constant"], moved["selected"], strict=True)
    ]
    told = f"Design trials with these inputs and constants: python -m pipeline ARGUMENTS {' '.join(keys)}"
    return [told] if keys else []
