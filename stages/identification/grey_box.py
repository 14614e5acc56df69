"""Models on the amended plant: its force is their mean, and a Gaussian process tells what it leaves.

In: `points` and `models` of the design's arm, `hyperprior` and `scaling`, the recordings of the executed trials, and
what the search made of them (`amended_values`, `learned_maps`, `channels`, `measured_muscles`); to test on, `bank`, and
`unseen_bank` and `task_movements` where there are some, whose force the evaluation alone reads. Out: `grey_box_errors`,
of four rungs (the nominal plant, the amended one, the Gaussian process as the design left it, and that of what the
amended plant leaves), `grey_box_coverage`, `grey_box_models`, and `grey_box_summary`. This stage only reads: it chooses
and measures nothing.
"""

from collections.abc import Mapping, Sequence
from typing import Annotated, Any, ClassVar, Self

import numpy as np
import pandas as pd
from pydantic import Field, PositiveInt, model_validator
from scipy.special import ndtri

from pipeline.config import Section, View
from pipeline.context import Context
from pipeline.stage import stage
from pipeline.table import Table, column, sentences
from stages.science.discrepancy.amendment import amend_plant
from stages.science.discrepancy.restoring import read_maps
from stages.science.figures.grey_box import draw_rungs
from stages.science.gp.expected_error import scale_intervals
from stages.science.gp.marginal import MarginalGP
from stages.science.muscle_models.error_rates import ALL_MUSCLES, TEST_WORDS, add_average
from stages.science.muscle_models.grey_box import GreyBox, leave_residual, predict_interval
from stages.science.muscle_models.inputs import ModelSettings
from stages.science.muscle_models.muscle_set import WHO, ExperimentModels, RecordedModels
from stages.science.muscle_models.samples import gather_tests, keep_wanted, locate_points, thin
from stages.science.plant.exoskeleton import Exoskeleton
from stages.science.plant.measured_motion import simulate_force
from stages.science.plant.plant import Plant
from stages.science.signals.executed_trials import join_executed
from stages.science.signals.measures import error_rate
from stages.science.signals.scaling import MODEL_OUTPUT, Array
from stages.science.statistics.intervals import Coverage, cover_blocks

LEVEL = 0.95
QUANTILE = float(ndtri(0.5 + LEVEL / 2))
FEWEST = 5
"""Movements below which a share's interval says nothing, and trials below which intervals are not widened by them."""
NOMINAL, AMENDED, PROCESS, GREY_BOX = RUNGS = ("nominal_plant", "amended_plant", "gaussian_process", "grey_box")
DESCRIBED = {
    NOMINAL: "the plant as the configuration has it",
    AMENDED: "with fitted constants, named effects and learned maps",
    PROCESS: "of the force, as the design left it",
    GREY_BOX: "of what the amended plant leaves, on the same points",
}
PLANTS = (NOMINAL, AMENDED)

EXPERIMENT = {
    "participant": column(str, "who tracked"),
    "experiment": column(int, "experiment of this participant", low=1),
}
TESTED_ON = column(
    str,
    "task: the movements that models are wanted for; bank: those that trials were chosen from; unseen_bank: movements "
    "that nothing else saw",
    among=["task", "bank", "unseen_bank"],
)
MUSCLE = column(str, "muscle, or mean for the average over muscles")
GREY_BOX_SUMMARY = Table(
    "grey_box_summary",
    "Error rate of each rung (RMSE / largest test force, mean over experiments), and what the 95 % intervals hold",
    {
        "tested_on": TESTED_ON,
        "muscle": MUSCLE,
        **{name: column(float, f"error rate: {told}", percent=True, low=0) for name, told in DESCRIBED.items()},
        "process_covered": column(
            float,
            "share of the forces within 95 % intervals of gaussian_process, mean over experiments",
            percent=True,
            low=0,
            high=1,
        ),
        "grey_box_covered": column(float, "the same of grey_box", percent=True, low=0, high=1),
        "experiments": column(int, "how many", low=1),
        "points": column(float, "samples that the models of a muscle stand on, mean over experiments", low=1),
    },
    key=("tested_on", "muscle"),
    brief=("tested_on", *DESCRIBED, "grey_box_covered"),
    main=("muscle", ALL_MUSCLES),
)
GREY_BOX_ERRORS = Table(
    "grey_box_errors",
    "Error rate of one rung in one experiment, over every sample of a test set",
    {
        **EXPERIMENT,
        "tested_on": TESTED_ON,
        "muscle": MUSCLE,
        "rung": column(str, "; ".join(f"{name}: {told}" for name, told in DESCRIBED.items()), among=list(RUNGS)),
        "error_rate": column(float, "RMSE of the force over the largest force of the test data", percent=True, low=0),
    },
    key=(*EXPERIMENT, "tested_on", "muscle", "rung"),
)
GREY_BOX_COVERAGE = Table(
    "grey_box_coverage",
    "How often the 95 % intervals of a muscle's model, hyperparameters marginalised, hold the measured force",
    {
        **EXPERIMENT,
        "tested_on": TESTED_ON,
        "muscle": column(str, "muscle"),
        "rung": column(str, "which model", among=[PROCESS, GREY_BOX]),
        "samples": column(int, "measured forces", low=1),
        "trajectories": column(int, "movements that they are of", low=1),
        "share": column(float, "share of the forces within their intervals", percent=True, low=0, high=1),
        "low": column(float, "lower end of its 95 % interval (t over movements)", low=0, high=1, nullable=True),
        "high": column(float, "upper end of its 95 % interval (t over movements)", low=0, high=1, nullable=True),
        "half_width_n": column(float, "mean half width of the intervals", unit="N", low=0),
        "width_factor": column(
            float,
            "factor on the widths that the model's own uncertainty makes, so that intervals hold 95 % of the designed "
            f"trials' samples, each trial left out of the model; 1 where they do without it, and below {FEWEST} trials",
            low=1,
        ),
        "verdict": column(
            str,
            "whether the intervals hold the 95 % that they say, by the interval of the share, or by the share itself "
            f"where it is the same in all movements; undecided below {FEWEST} movements",
            among=["as said", "too narrow", "too wide", "undecided"],
        ),
    },
    key=(*EXPERIMENT, "tested_on", "muscle", "rung"),
)
GREY_BOX_MODELS = Table(
    "grey_box_models",
    "One hyperparameter of the Gaussian process of what the amended plant leaves, at the maximum of its posterior",
    {
        **EXPERIMENT,
        "muscle": column(str, "muscle"),
        "hyperparameter": column(str, "as in hyperprior"),
        "value": column(float, "maximum a posteriori, in the unit that hyperprior names"),
        "sd": column(float, "standard deviation of the Laplace approximation, in the same unit", low=0),
        "log_posterior": column(float, "of the whole vector (nats)"),
        "points": column(int, "samples that the model stands on", low=1),
        "repair": column(str, "what was done about an indefinite Hessian or a failed factorisation; empty = nothing"),
    },
    key=(*EXPERIMENT, "muscle", "hyperparameter"),
)
GREY_BOX_FINDINGS = sentences("grey_box_findings", "finding")
ERROR_BY_STEP = Table(
    "error_by_step",
    "What each step of the workflow leaves: error rate (RMSE / largest test force)",
    {
        "step": column(str, "what predicts"),
        "executed": column(int, "trials that were executed until then, of all experiments (count)", low=0),
        **{
            name: column(
                float,
                f"error rate on the {told}, mean over muscles and experiments",
                low=0,
                optional=True,
                percent=True,
            )
            for name, told in (("task", "task"), ("bank", "bank"), ("unseen_bank", "unseen bank"))
        },
    },
    key=("step",),
)


class GreyBoxSettings(Section):
    """Config group ``grey_box``."""

    starts: Annotated[int, Field(ge=0, le=1000)]
    smoothing_s: Annotated[float, Field(gt=0, le=3600)]
    every: PositiveInt


class PlantsApart(View):
    """The search, and the rung without it, begin from a plant without the effects that a simulated rig has."""

    plant: Plant
    rig: dict[str, Any]

    @model_validator(mode="after")
    def _know_no_truth(self) -> Self:
        own = self.rig.get("plant")
        if own is not None and self.plant.effects and Plant.model_validate(own).effects == self.plant.effects:
            names = ", ".join(dict.fromkeys(each.name for each in self.plant.effects))
            raise ValueError(
                f"plant: expected what is known of the machine before the search, got the effects that the simulated "
                f"rig has ({names}); set plant=nominal rig=sim_own_plant, and plant@rig_plant=NAME for the rig's"
            )
        return self


class Config(Section):
    """What this stage reads."""

    checks: ClassVar = (PlantsApart,)

    grey_box: GreyBoxSettings
    plant: Plant
    exoskeleton: Exoskeleton
    model: ModelSettings
    seed: int


@stage(
    ERROR_BY_STEP,
    GREY_BOX_SUMMARY,
    GREY_BOX_ERRORS,
    GREY_BOX_COVERAGE,
    GREY_BOX_MODELS,
    GREY_BOX_FINDINGS,
    stream="grey_box",
)
def grey_box(
    cfg: Config,
    bank: pd.DataFrame,
    hyperprior: pd.DataFrame,
    scaling: pd.DataFrame,
    models: pd.DataFrame,
    points: pd.DataFrame,
    hardware_recordings: pd.DataFrame,
    active_recordings: pd.DataFrame,
    amended_values: pd.DataFrame,
    learned_maps: pd.DataFrame,
    channels: pd.DataFrame,
    measured_muscles: pd.DataFrame,
    ctx: Context,
    discrimination_values: pd.DataFrame | None = None,
    task_movements: pd.DataFrame | None = None,
    unseen_bank: pd.DataFrame | None = None,
) -> dict[str, pd.DataFrame]:
    """Identify what the amended plant leaves, and compare it with each plant alone and with the design's models."""
    learned = list(read_maps(learned_maps).values())
    amended = Plant.model_validate(amend_plant(cfg.plant, amended_values, learned, channels, measured_muscles))
    plants = {NOMINAL: cfg.plant, AMENDED: amended}
    plants |= amend_by_steps(cfg.plant, discrimination_values, amended_values, channels, measured_muscles)
    given = {"task": task_movements, "bank": bank, "unseen_bank": unseen_bank}
    tests = {name: add_forces(each, plants, cfg) for name, each in gather_tests(cfg.model, given).items()}
    design = str(models["arm"].iloc[0])
    own_models, own_points = (each[each["arm"] == design] for each in (models, points))
    executed = join_executed(hardware_recordings, active_recordings)
    force = simulate_force(amended, cfg.exoskeleton, executed, ["trial"], cfg.grey_box.smoothing_s, in_session=True)
    known = locate_points(own_points, hardware_recordings, active_recordings, {AMENDED: force})
    own = active_recordings[active_recordings["arm"] == design]
    samples = cfg.model.extend(own.assign(**{AMENDED: force[-len(own) :]}), [*WHO, "trial"])
    samples = thin(samples, cfg.grey_box.every, [*WHO, "trial"])
    samples_of = dict[Any, pd.DataFrame](list(samples.groupby([*WHO, "muscle"], sort=False)))
    recorded = {str(name): RecordedModels.read(hyperprior, scaling, name) for name in hyperprior["muscle"].unique()}
    tests_of = {muscle: {name: each[each["muscle"] == muscle] for name, each in tests.items()} for muscle in recorded}
    jobs = {}
    for note, its in ExperimentModels.split(recorded, own_models, known).items():
        where = its.participant, its.experiment, its.muscle
        generator = ctx.generator("starts", *where)
        jobs[note] = its, samples_of[where], tests_of[its.muscle], cfg.grey_box, generator
    rows = ctx.gather("experiments", judge_muscle, jobs)
    told = {
        table.name: pd.DataFrame([row for name, row in rows if name == table.name], columns=list(table.columns))
        for table in (GREY_BOX_ERRORS, GREY_BOX_COVERAGE, GREY_BOX_MODELS)
    }
    errors = add_average(told[GREY_BOX_ERRORS.name])[list(GREY_BOX_ERRORS.columns)]
    steps = list_steps(errors, tests, list(plants), executed["trial"].nunique(), bool(learned))
    told |= {GREY_BOX_ERRORS.name: errors, ERROR_BY_STEP.name: steps}
    summary = summarise(errors, told[GREY_BOX_COVERAGE.name], told[GREY_BOX_MODELS.name])
    experiments = int(summary["experiments"].max())
    ctx.figure(
        "grey_box",
        draw_rungs(errors, list(RUNGS), list(tests)),
        "Error rate (RMSE over the largest force of the test data) of "
        + "; ".join(f"{name.replace('_', ' ')}: {described}" for name, described in DESCRIBED.items())
        + (f". Means over {experiments} experiments, small points are experiments." if experiments > 1 else "."),
    )
    findings = describe_rungs(summary, list(tests))
    return {GREY_BOX_SUMMARY.name: summary, **told, GREY_BOX_FINDINGS.name: pd.DataFrame({"sentence": findings})}


def describe_rungs(summary: pd.DataFrame, tests: Sequence[str]) -> list[str]:
    """Return what the rungs err by on the first test set, and what the grey box errs by on the others.

    An amended plant that errs more than the one before is told, as nothing then speaks for it.
    """
    rows = summary[summary["muscle"] == ALL_MUSCLES].to_dict("records")
    first, *others = sorted(rows, key=lambda row: tests.index(row["tested_on"]))
    rates = {name: f"{100 * first[name]:.2g} %" for name in RUNGS}
    told = [
        f"Models on the amended plant (grey box) err by {rates[GREY_BOX]} of the largest force on "
        f"{TEST_WORDS[first['tested_on']]} (mean of {first['experiments']} "
        f"experiment{'s' * (first['experiments'] > 1)}); "
        f"the designed trials' models alone (Gaussian process) err by {rates[PROCESS]}, the amended plant alone by "
        f"{rates[AMENDED]}, the plant as it was before the search by {rates[NOMINAL]}."
    ]
    where = [f"{100 * row[GREY_BOX]:.2g} % on {TEST_WORDS[row['tested_on']]}" for row in others]
    held = [f"{100 * row['grey_box_covered']:.0f} % on {TEST_WORDS[row['tested_on']]}" for row in (first, *others)]
    covered = ", ".join(held).replace("%", "% of the measured forces", 1)
    told += [f"They err by {' and by '.join(where)}."] if where else []
    if all(row[AMENDED] > row[NOMINAL] for row in rows):
        told.append("The amended plant errs more than the plant before the search: keep that until more trials tell.")
    return [*told, f"Their 95 % intervals hold {covered}."]


def amend_by_steps(
    plant: Plant, values: pd.DataFrame | None, last: pd.DataFrame, channels: pd.DataFrame, muscles: pd.DataFrame
) -> dict[str, Plant]:
    """Return the plant without learned maps as it was amended before each trial that tells names apart, and at last."""
    earlier = [] if values is None else [rows for _, rows in values.groupby("trial")]
    return {
        f"{AMENDED}_{number}": Plant.model_validate(amend_plant(plant, rows, [], channels, muscles))
        for number, rows in enumerate([*earlier, last])
    }


def list_steps(
    errors: pd.DataFrame, tests: Mapping[str, pd.DataFrame], plants: Sequence[str], designed: int, learned: bool
) -> pd.DataFrame:
    """Return the rows of `error_by_step`, from the error rates of all rungs and tests with the force of all plants.

    `designed` is the number of trials before any that tells names apart; `learned` says whether there are learned maps.
    """
    mean = errors[errors["muscle"] == ALL_MUSCLES].groupby(["rung", "tested_on"])["error_rate"].mean()
    rungs = {name: {test: float(mean[name, test]) for test in tests} for name in RUNGS}
    amended = [name for name in plants if name not in RUNGS]
    own = {name: {test: average_rate(samples, name) for test, samples in tests.items()} for name in amended}
    further = len(amended) - 1
    steps = [
        ("nominal plant", 0, rungs[NOMINAL]),
        ("Gaussian process of the designed trials", designed, rungs[PROCESS]),
        *((f"amended plant before further trial {k + 1}", designed + k, own[amended[k]]) for k in range(further)),
        ("amended plant", designed + further, own[amended[-1]]),
        *([("amended plant and learned maps", designed + further, rungs[AMENDED])] if learned else []),
        ("grey box", designed + further, rungs[GREY_BOX]),
    ]
    rows = [{"step": name, "executed": known, **rates} for name, known, rates in steps]
    return ERROR_BY_STEP.select(pd.DataFrame(rows))


def average_rate(samples: pd.DataFrame, plant: str) -> float:
    """Return the error rate of a plant's force on a test set, mean over muscles."""
    rates = [error_rate(its[plant].to_numpy(), its[MODEL_OUTPUT].to_numpy()) for _, its in samples.groupby("muscle")]
    return float(np.mean(rates))


def add_forces(recordings: pd.DataFrame, plants: Mapping[str, Plant], cfg: Config) -> pd.DataFrame:
    """Return a test set's wanted samples, with a column for the force of each plant at their pressure and motion."""
    smoothing_s = cfg.grey_box.smoothing_s
    forces = {
        name: simulate_force(plant, cfg.exoskeleton, recordings, ["trajectory"], smoothing_s)
        for name, plant in plants.items()
    }
    return keep_wanted(recordings.assign(**forces))


def judge_muscle(
    learned: ExperimentModels,
    samples: pd.DataFrame,
    tests: Mapping[str, pd.DataFrame],
    settings: GreyBoxSettings,
    generator: np.random.Generator,
) -> list[tuple[str, tuple[Any, ...]]]:
    """Return rows of one muscle in one experiment, each with the name of its table.

    The design's models, their points and the samples of its trials, all with the amended plant's force, are given.
    """
    who, muscle, points = (learned.participant, learned.experiment), learned.muscle, learned.points
    recorded, scaling = learned.recorded, learned.recorded.scaling
    last = learned.models[learned.models["trial"] == learned.models["trial"].max()]
    process = recorded.rebuild(last, points)
    search = generator, settings.starts, [process.theta]
    grey = GreyBox.identify(recorded, points, points[AMENDED].to_numpy(), *search)

    def scale(model: MarginalGP, plant_n: Array | float) -> float:
        """Return the factor on the widths of a model's intervals, of what the plant's force leaves of the samples'."""
        inputs, left = leave_residual(scaling, samples, plant_n)
        executed = [(inputs[rows], left[rows]) for rows in samples.groupby("trial").indices.values()]
        if len(executed) < FEWEST:
            return 1.0
        return max(1.0, scale_intervals(model, points["trial"].to_numpy() - 1, executed, LEVEL))

    factors = {
        PROCESS: scale(process, scaling.force_centre_n),
        GREY_BOX: scale(grey.residual, samples[AMENDED].to_numpy()),
    }
    told: list[tuple[str, tuple[Any, ...]]] = []
    for tested_on, test in tests.items():
        inputs, (nominal_n, plant_n, force_n) = scaling.inputs_of(test), test[[*PLANTS, MODEL_OUTPUT]].to_numpy().T
        forces = {
            NOMINAL: nominal_n,
            AMENDED: plant_n,
            PROCESS: scaling.restore_force(process.predict_mean(inputs)),
            GREY_BOX: grey.predict_mean(inputs, plant_n),
        }
        for rung in RUNGS:
            rate = error_rate(forces[rung], force_n)
            told.append((GREY_BOX_ERRORS.name, (*who, tested_on, muscle, rung, rate)))
        inputs, plant_n, force_n = (each[:: settings.every] for each in (inputs, plant_n, force_n))
        for rung, (mean_n, half_n) in (
            (PROCESS, predict_interval(process, scaling, inputs, QUANTILE * factors[PROCESS])),
            (GREY_BOX, grey.predict_interval(inputs, plant_n, QUANTILE * factors[GREY_BOX])),
        ):
            movements = test["trajectory"].iloc[:: settings.every]
            covered = cover_blocks(force_n, mean_n - half_n, mean_n + half_n, movements)
            widths = float(half_n.mean()), factors[rung], judge_coverage(covered)
            told.append((GREY_BOX_COVERAGE.name, (*who, tested_on, muscle, rung, *vars(covered).values(), *widths)))
    residual = grey.residual
    columns = residual.theta, np.sqrt(np.diag(residual.laplace.covariance))
    for name, value, sd in zip(last["hyperparameter"], *columns, strict=True):
        row = (*who, muscle, name, float(value), float(sd), residual.log_posterior, len(points), residual.repair)
        told.append((GREY_BOX_MODELS.name, row))
    return told


def judge_coverage(covered: Coverage) -> str:
    """Return whether 95 % intervals hold what they say."""
    if covered.blocks < FEWEST:
        return "undecided"
    low, high = (covered.share if np.isnan(each) else each for each in (covered.low, covered.high))
    return "too wide" if low > LEVEL else "too narrow" if high < LEVEL else "as said"


def summarise(errors: pd.DataFrame, coverage: pd.DataFrame, models: pd.DataFrame) -> pd.DataFrame:
    """Return the rows of `grey_box_summary`, the average over muscles last."""
    keys = ["tested_on", "muscle"]
    rates = errors.groupby([*keys, "rung"], sort=False)["error_rate"].mean().unstack("rung")
    shares = pd.concat([coverage, coverage.assign(muscle=ALL_MUSCLES)])
    covered = shares.groupby([*keys, "rung"], sort=False)["share"].mean().unstack("rung")
    stood_on = pd.concat([models, models.assign(muscle=ALL_MUSCLES)]).groupby("muscle")["points"].mean()
    order = [(test, name) for test in errors["tested_on"].unique() for name in errors["muscle"].unique()]
    told = rates.loc[order].assign(process_covered=covered[PROCESS], grey_box_covered=covered[GREY_BOX])
    told = told.assign(experiments=errors.groupby(WHO).ngroups).reset_index()
    return told.assign(points=told["muscle"].map(stood_on))[list(GREY_BOX_SUMMARY.columns)]
