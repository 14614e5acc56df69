"""What was chosen again and again, the force that was learned, and how sure the models are of it (paper, section 6.2).

In: `trials`, `initial_trials`, `references`, `models`, `points`, `hyperprior`, `scaling`, `bank` and, where it exists,
`unseen_bank`. Out: `chosen_often` and `choice_concentration` for every arm, `force_surfaces` of the design's last
models, and `coverage` and `reliability`: how often the 95 % intervals of the marginal GP and of the plain one hold the
measured force. This stage only reads: it chooses and measures nothing.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from itertools import product
from typing import Annotated, Any, ClassVar, Self

import numpy as np
import pandas as pd
from pydantic import Field, PositiveInt, model_validator
from scipy.special import ndtri

from pipeline.config import Section, View
from pipeline.context import Context
from pipeline.errors import suggest
from pipeline.stage import stage
from pipeline.table import Table, column
from stages.science.figures.learned_models import draw_force_surfaces, draw_frequent_references, draw_reliability
from stages.science.gp.marginal import MarginalGP
from stages.science.muscle_models.error_rates import ALL_MUSCLES
from stages.science.muscle_models.inputs import MeasuredInputs
from stages.science.muscle_models.muscle_set import ExperimentModels, RecordedModels
from stages.science.muscle_models.samples import list_tests
from stages.science.plant.exoskeleton import Exoskeleton
from stages.science.signals.scaling import MODEL_INPUTS, MODEL_OUTPUT, Scaling
from stages.science.statistics.concentration import Choices, judge_concentration
from stages.science.statistics.intervals import bound_mean, cover_blocks
from stages.science.statistics.paired import adjust_holm, compare_pairs
from stages.science.statistics.verdicts import LEVEL, judge_differences

NOMINAL = 0.95
QUANTILE = float(ndtri(0.5 + NOMINAL / 2))
PLAIN, MARGINAL = "plain", "marginal"
PRESSURE, CONTRACTION, VELOCITY = MODEL_INPUTS
SECTIONS = {"pressure_velocity": (PRESSURE, VELOCITY), "pressure_contraction": (PRESSURE, CONTRACTION)}

ARM = column(str, "how trajectories were chosen")
TESTED_ON = column(str, "recordings that forces are measured in", among=["bank", "unseen_bank"])
TRIAL = column(int, "trials learned from; 0 = initial data alone", low=0)
CHOSEN_OFTEN = Table(
    "chosen_often",
    "How often a trajectory was chosen in an arm, the most frequent first",
    {
        "arm": ARM,
        "trajectory": column(int, "movement of the bank", low=0),
        "times": column(int, "trials in which it was chosen, over all experiments", low=0),
        "share": column(float, "share of the experiments in which it was chosen", low=0, high=1),
        "experiments": column(int, "experiments of this arm", low=1),
        "rank": column(int, "1 = most often; equally often chosen ones share a rank", low=1),
    },
    key=("arm", "trajectory"),
)
CHOICE_CONCENTRATION = Table(
    "choice_concentration",
    "Whether the experiments of an arm chose the same trajectories more often than at random",
    {
        "arm": ARM,
        "n": column(int, "experiments", low=1),
        "trials": column(int, "choices of all experiments", low=1),
        "dispersion": column(float, "sum over trajectories of (times chosen - expected)^2 / expected", low=0),
        "expected": column(float, "its mean where choices are random among what was not executed yet", low=0),
        "low": column(float, "lower end of the central 95 % of it at random", low=0),
        "high": column(float, "upper end of the central 95 % of it at random", low=0),
        "effect": column(float, "effect size: dispersion over its mean at random", low=0, nullable=True),
        "p": column(float, "one-sided, Monte Carlo", low=0, high=1),
        "p_holm": column(float, "p adjusted by Holm over the arms", low=0, high=1),
        "verdict": column(
            str,
            f"concentrated at p_holm below {LEVEL}; else not told from choosing at random",
            among=["concentrated", "as at random"],
        ),
    },
    key=("arm",),
    brief=("arm", "n", "dispersion", "expected", "low", "high", "effect", "p_holm", "verdict"),
)
FORCE_SURFACES = Table(
    "force_surfaces",
    "Force of a muscle by the design's model after the last trial of the first experiment, where one input is held",
    {
        "muscle": column(str, "muscle"),
        "section": column(
            str, "inputs that vary; contraction is held at the bank's median, velocity at 0", among=list(SECTIONS)
        ),
        PRESSURE: column(float, "pressure", unit="kPa"),
        CONTRACTION: column(float, "contraction"),
        VELOCITY: column(float, "contraction velocity", unit="1/s"),
        "mean_n": column(float, "predicted force", unit="N"),
        "sd_n": column(float, "its standard deviation without noise, hyperparameters marginalised", unit="N", low=0),
        "nearest": column(float, "distance to the bank's nearest sample, in its SDs", unit="standard units", low=0),
    },
    key=("muscle", "section", *MODEL_INPUTS),
)
COVERAGE = Table(
    "coverage",
    "How often the 95 % intervals of one muscle's model hold the measured force, after one trial",
    {
        "participant": column(str, "who tracked"),
        "experiment": column(int, "experiment of this participant", low=1),
        "arm": ARM,
        "trial": TRIAL,
        "tested_on": TESTED_ON,
        "muscle": column(str, "muscle"),
        "model": column(str, "plain: hyperparameters at their MAP; marginal: marginalised", among=[PLAIN, MARGINAL]),
        "samples": column(int, "measured forces", low=1),
        "trajectories": column(int, "movements that they are of", low=1),
        "share": column(float, "share of the forces within their intervals", low=0, high=1),
        "low": column(float, "lower end of its 95 % interval (t over movements)", low=0, high=1, nullable=True),
        "high": column(float, "upper end of its 95 % interval (t over movements)", low=0, high=1, nullable=True),
        "half_width_n": column(float, "mean half width of the intervals", unit="N", low=0),
    },
    key=("participant", "experiment", "arm", "trial", "tested_on", "muscle", "model"),
)
RELIABILITY = Table(
    "reliability",
    "Whether the marginal GP's 95 % intervals hold the measured force in nearer to 95 % of the cases than the plain's",
    {
        "arm": ARM,
        "tested_on": TESTED_ON,
        "muscle": column(str, "muscle, or mean for the average over muscles"),
        "trial": TRIAL,
        "n": column(int, "experiments, all on the same test set", low=1),
        "plain_share": column(float, "forces within the plain GP's intervals, mean over experiments", low=0, high=1),
        "plain_low": column(float, "lower end of its 95 % interval (t over experiments)", nullable=True),
        "plain_high": column(float, "upper end of its 95 % interval (t over experiments)", nullable=True),
        "marginal_share": column(float, "within the marginal GP's", low=0, high=1),
        "marginal_low": column(float, "lower end of its 95 % interval (t over experiments)", nullable=True),
        "marginal_high": column(float, "upper end of its 95 % interval (t over experiments)", nullable=True),
        "plain_gap": column(float, f"distance of the plain GP's share from {NOMINAL}, mean over experiments", low=0),
        "marginal_gap": column(float, "the marginal GP's", low=0),
        "difference": column(float, "marginal less plain gap"),
        "low": column(float, "lower end of its 95 % interval (t)", nullable=True),
        "high": column(float, "upper end of its 95 % interval (t)", nullable=True),
        "d_z": column(float, "effect size: difference over the SD of differences", nullable=True),
        "wider": column(float, "width of the marginal GP's intervals over the plain's, mean over experiments", low=0),
        "p_t": column(float, "two-sided paired t-test", low=0, high=1, nullable=True),
        "p_wilcoxon": column(float, "two-sided Wilcoxon signed-rank test", low=0, high=1, nullable=True),
        "p_holm": column(
            float, "p_t adjusted by Holm over the rows of this arm and test set", low=0, high=1, nullable=True
        ),
        "verdict": column(str, f"at p_holm below {LEVEL}", among=["marginal closer", "plain closer", "undecided"]),
    },
    key=("arm", "tested_on", "muscle", "trial"),
    brief=("arm", "tested_on", "muscle", "trial", "plain_share", "marginal_share", "difference", "p_holm", "verdict"),
)


class Surfaces(Section):
    """Force over two inputs."""

    muscle: str
    grid: Annotated[int, Field(ge=2, le=200)]
    near: Annotated[float, Field(gt=0, le=10)]


class ReliabilitySettings(Section):
    """Coverage of intervals."""

    experiments: PositiveInt
    every: PositiveInt


class LearnedModels(Section):
    """Config group ``learned_models``."""

    draws: Annotated[int, Field(ge=100, le=1_000_000)]
    shown: Annotated[int, Field(ge=1, le=6)]
    surfaces: Surfaces
    reliability: ReliabilitySettings


class SamplesLeft(View):
    """Thinning leaves more than one test sample of a movement."""

    model: MeasuredInputs
    learned_models: LearnedModels
    exoskeleton: Exoskeleton

    @model_validator(mode="after")
    def _keep_two_samples(self) -> Self:
        every, samples = self.learned_models.reliability.every, self.exoskeleton.samples
        if every >= samples:
            raise ValueError(
                f"learned_models.reliability.every: expected less than the {samples} samples of a movement, "
                f"got {every}; lower it"
            )
        return self


class Config(Section):
    """What this stage reads."""

    checks: ClassVar = (SamplesLeft,)

    learned_models: LearnedModels
    exoskeleton: Exoskeleton
    seed: int

    @model_validator(mode="after")
    def _know_the_muscle(self) -> Self:
        name, known = self.learned_models.surfaces.muscle, self.exoskeleton.muscle_names
        if name not in known:
            raise ValueError(f"learned_models.surfaces.muscle: no muscle '{name}'; {suggest(name, known)}")
        return self


@stage(CHOSEN_OFTEN, CHOICE_CONCENTRATION, FORCE_SURFACES, COVERAGE, RELIABILITY, stream="learned_models")
def learned_models(
    cfg: Config,
    trials: pd.DataFrame,
    initial_trials: pd.DataFrame,
    references: pd.DataFrame,
    models: pd.DataFrame,
    points: pd.DataFrame,
    hyperprior: pd.DataFrame,
    scaling: pd.DataFrame,
    bank: pd.DataFrame,
    ctx: Context,
    unseen_bank: pd.DataFrame | None = None,
) -> tuple[pd.DataFrame, ...]:
    """Count the choices, draw the learned forces and check how often intervals hold the measured ones."""
    section = cfg.learned_models
    muscles = [str(name) for name in hyperprior["muscle"].unique()]
    recorded = {name: RecordedModels.read(hyperprior, scaling, name) for name in muscles}
    design = str(models["arm"].iloc[0])

    movements = [int(each) for each in references["trajectory"].unique()]
    often = count_choices(trials, movements)
    concentration = judge_choices(trials, initial_trials, movements, section.draws, ctx)
    shown, groups = often[often["arm"] == design].head(section.shown), cfg.exoskeleton.muscles_by_joint
    caption = (
        f"The {len(shown)} trajectories that {design} chose most often, of {len(movements)}: each joint's "
        "reference and the pressure commands of its muscles. Above each: in how many of the experiments it was chosen."
    )
    ctx.figure("frequent_references", draw_frequent_references(shown, references, groups), caption)

    tests = list_tests({"bank": bank, "unseen_bank": unseen_bank})
    first = models[models["arm"] == design].iloc[0]
    own = ["arm", "participant", "experiment"]
    its_models, known = (each[(each[own] == first[own]).all(axis=1)] for each in (models, points))
    forces = draw_up_forces(recorded, its_models, known, tests["bank"], section.surfaces.grid)
    show_forces(section.surfaces, forces, its_models.sort_values("trial").iloc[-1], known, ctx)

    jobs = gather(recorded, tests, models, points, section.reliability)
    rows = ctx.gather("experiments", measure_coverage, jobs)
    coverage = pd.DataFrame(rows, columns=list(COVERAGE.columns))
    told = tabulate_reliability(coverage, muscles)
    its = told[told["arm"] == design]
    caption = (
        f"Share of the measured forces within the 95 % intervals of the plain and of the marginal GP, by {design}: "
        f"mean and its 95 % interval over {its['n'].max()} experiments. 95 % would be right."
    )
    ctx.figure("reliability", draw_reliability(its, [ALL_MUSCLES, *muscles]), caption)
    return often, concentration, forces, coverage, told


def count_choices(trials: pd.DataFrame, trajectories: list[int]) -> pd.DataFrame:
    """Return the rows of `chosen_often`, for every trajectory of the bank."""
    frames = []
    for arm, its in trials.groupby("arm", sort=False):
        experiments = its.groupby(["participant", "experiment"]).ngroups
        distinct = its.drop_duplicates(["participant", "experiment", "trajectory"])
        times, in_experiments = (
            each["trajectory"].value_counts().reindex(trajectories, fill_value=0).to_numpy() for each in (its, distinct)
        )
        counted = pd.DataFrame({"arm": str(arm), "trajectory": list(trajectories), "times": times})
        counted = counted.assign(share=in_experiments / experiments, experiments=experiments)
        counted["rank"] = counted["times"].rank(method="min", ascending=False).astype(int)
        frames.append(counted.sort_values(["rank", "trajectory"]))
    return pd.concat(frames, ignore_index=True)


def judge_choices(
    trials: pd.DataFrame, initial_trials: pd.DataFrame, trajectories: Sequence[int], draws: int, ctx: Context
) -> pd.DataFrame:
    """Return the rows of `choice_concentration`."""
    initial = {
        key: set(its["trajectory"]) for key, its in initial_trials.groupby(["participant", "experiment"], sort=False)
    }
    known = np.sort(np.array(trajectories))
    rows = []
    for arm, its in trials.groupby("arm", sort=False):
        # where nothing is excluded, all trajectories are there in every trial
        again = bool((its["available"] == known.size).all())
        experiments = []
        for key, chosen in its.groupby(["participant", "experiment"], sort=False):
            free = ~np.isin(known, [] if again else list(initial[key]))
            at = np.searchsorted(known, chosen["trajectory"].to_numpy())
            experiments.append(Choices(at, np.flatnonzero(free), again))
        told = judge_concentration(experiments, known.size, draws, ctx.generator("choices", str(arm)))
        rows.append({"arm": str(arm), "trials": len(its), **vars(told)})
    frame = pd.DataFrame(rows)
    adjusted = adjust_holm(frame["p"].to_numpy())
    verdict = np.where(adjusted < LEVEL, "concentrated", "as at random")
    return frame.assign(p_holm=adjusted, verdict=verdict)[list(CHOICE_CONCENTRATION.columns)]


def draw_up_forces(
    recorded: Mapping[str, RecordedModels], models: pd.DataFrame, points: pd.DataFrame, bank: pd.DataFrame, grid: int
) -> pd.DataFrame:
    """Return the rows of `force_surfaces`, from the models and points of one experiment and arm after the last trial.

    The bank gives the range of each input, of which there are `grid` values, and the samples that states are near to.
    """
    from scipy.spatial import KDTree  # slow to import

    last = models[models["trial"] == models["trial"].max()]
    frames = []
    for muscle, its in recorded.items():
        gp = its.rebuild(last[last["muscle"] == muscle], points[points["muscle"] == muscle])
        samples = bank[bank["muscle"] == muscle]
        tree = KDTree(its.scaling.inputs_of(samples))
        for section, varied in SECTIONS.items():
            states = lay_grid(samples, varied, grid, its.scaling)
            inputs = its.scaling.inputs_of(states)
            mean, variance = gp.predict_marginal(inputs)
            columns = {
                "mean_n": its.scaling.restore_force(mean),
                "sd_n": its.scaling.force_scale_n * np.sqrt(variance),
                "nearest": tree.query(inputs)[0],
            }
            frames.append(states.assign(muscle=muscle, section=section, **columns))
    return pd.concat(frames, ignore_index=True)[list(FORCE_SURFACES.columns)]


def lay_grid(samples: pd.DataFrame, varied: Sequence[str], grid: int, scaling: Scaling) -> pd.DataFrame:
    """Return states over the range of two inputs in the samples, the third held: contraction median, velocity zero."""
    axes = []
    for name in varied:
        low, high = float(samples[name].min()), float(samples[name].max())
        if low == high:
            unit = float(scaling.input_scale[MODEL_INPUTS.index(name)])
            low, high = low - unit, high + unit
        axes.append(np.linspace(low, high, grid))
    first, second = (each.ravel() for each in np.meshgrid(*axes, indexing="ij"))
    held = {PRESSURE: 0.0, CONTRACTION: float(samples[CONTRACTION].median()), VELOCITY: 0.0}
    states = pd.DataFrame({**held, varied[0]: first, varied[1]: second})
    return states[list(MODEL_INPUTS)]


def show_forces(cfg: Surfaces, forces: pd.DataFrame, last: pd.Series[Any], points: pd.DataFrame, ctx: Context) -> None:
    """Draw the learned force of one muscle (paper, Fig. 11), with the points of its model."""
    muscle, near = cfg.muscle, cfg.near
    its, known = forces[forces["muscle"] == muscle], points[points["muscle"] == muscle]
    held = its.loc[its["section"] == "pressure_velocity", CONTRACTION].iloc[0]
    caption = (
        f"Force of {muscle} by {last['arm']}'s model after trial {last['trial']} ({last['participant']}, experiment "
        f"{last['experiment']}) and its standard deviation with the hyperparameters marginalised. Above at the bank's "
        f"median contraction, {held:.3f}, below at velocity 0. The model's points lie at other values of the input "
        f"that is held, and those beyond the bank's range are left out. Hatched: farther than {near:g} SDs of the bank "
        "from any of its samples."
    )
    ctx.figure("force_surfaces", draw_force_surfaces(its, known, SECTIONS, near), caption)


def gather(
    recorded: Mapping[str, RecordedModels],
    tests: Mapping[str, pd.DataFrame],
    models: pd.DataFrame,
    points: pd.DataFrame,
    section: ReliabilitySettings,
) -> dict[str, tuple[ExperimentModels, dict[str, pd.DataFrame]]]:
    """Return what `measure_coverage` takes, of every muscle in the first experiments, by a note of which it is.

    The models are those after trials 0, the middle and the last.
    """
    last = int(models["trial"].max())
    chosen = models[(models["experiment"] <= section.experiments) & models["trial"].isin([0, last // 2, last])]
    thinned = {
        name: frame[frame.groupby(["muscle", "trajectory"]).cumcount() % section.every == 0]
        for name, frame in tests.items()
    }
    tests_of = {muscle: {name: rows[rows["muscle"] == muscle] for name, rows in thinned.items()} for muscle in recorded}
    learned = ExperimentModels.split(recorded, chosen, points)
    return {note: (its, tests_of[its.muscle]) for note, its in learned.items()}


def measure_coverage(learned: ExperimentModels, tests: Mapping[str, pd.DataFrame]) -> list[tuple[Any, ...]]:
    """Return the rows of `coverage` of one muscle in one experiment, of all arms."""
    return learned.measure(partial(cover_forces, muscle=learned.muscle, scaling=learned.recorded.scaling, tests=tests))


def cover_forces(
    gp: MarginalGP, muscle: str, scaling: Scaling, tests: Mapping[str, pd.DataFrame]
) -> Iterator[tuple[Any, ...]]:
    """Yield the rows of `coverage` of one model, from the test set on: half widths are those of measured forces."""
    inputs = np.concatenate([scaling.inputs_of(test) for test in tests.values()])
    mean, plain = gp.predict(inputs)
    mean_n, variances = scaling.restore_force(mean), {PLAIN: plain, MARGINAL: gp.predict_marginal(inputs)[1]}
    start = 0
    for tested_on, test in tests.items():
        its, force_n = slice(start, start + len(test)), test[MODEL_OUTPUT].to_numpy()
        start = its.stop
        for name, variance in variances.items():
            half_n = QUANTILE * scaling.force_scale_n * np.sqrt(variance[its] + gp.noise_variance)
            told = cover_blocks(force_n, mean_n[its] - half_n, mean_n[its] + half_n, test["trajectory"])
            yield (tested_on, muscle, name, *vars(told).values(), float(half_n.mean()))


def tabulate_reliability(coverage: pd.DataFrame, muscles: Sequence[str]) -> pd.DataFrame:
    """Return the rows of `reliability`: both models on the same experiments.

    The average over muscles is that of their shares and that of their distances from 95 %, so that one that holds too
    many does not make up for one that holds too few.
    """
    told = coverage.assign(gap=(coverage["share"] - NOMINAL).abs())
    where = ["arm", "tested_on", "muscle", "trial", "participant", "experiment"]
    pairs = told.pivot(index=where, columns="model", values=["share", "gap", "half_width_n"])
    frame = pd.DataFrame(
        {
            **{f"{name}_{value}": pairs[value][name] for value in ("share", "gap") for name in (PLAIN, MARGINAL)},
            "wider": pairs["half_width_n"][MARGINAL] / pairs["half_width_n"][PLAIN],
        }
    ).reset_index()
    of_all = frame.groupby([name for name in where if name != "muscle"]).mean(numeric_only=True).reset_index()
    rows = pd.concat([frame, of_all.assign(muscle=ALL_MUSCLES)], ignore_index=True)
    families = []
    for arm, tested_on in product(coverage["arm"].unique(), coverage["tested_on"].unique()):
        family = rows[(rows["arm"] == arm) & (rows["tested_on"] == tested_on)]
        families.append(compare_models(family, [ALL_MUSCLES, *muscles]).assign(arm=arm, tested_on=tested_on))
    return pd.concat(families, ignore_index=True)[list(RELIABILITY.columns)]


def compare_models(family: pd.DataFrame, muscles: Sequence[str]) -> pd.DataFrame:
    """Return the rows of one arm and test set, whose p-values are adjusted together, from one for each experiment."""
    groups: dict[Any, pd.DataFrame] = dict(list(family.groupby(["muscle", "trial"])))
    found = []
    for muscle, trial in sorted(groups, key=lambda each: (muscles.index(each[0]), each[1])):
        its = groups[(muscle, trial)]
        told = compare_pairs(its[f"{MARGINAL}_gap"].to_numpy(), its[f"{PLAIN}_gap"].to_numpy())
        row = {"muscle": muscle, "trial": trial, "wider": its["wider"].mean(), **vars(told)}
        row |= {"marginal_gap": told.first_mean, "plain_gap": told.second_mean}
        for name in (PLAIN, MARGINAL):
            share, low, high = bound_mean(its[f"{name}_share"].to_numpy(), NOMINAL)
            row |= {f"{name}_share": share, f"{name}_low": low, f"{name}_high": high}
        found.append(row)
    return judge_differences(pd.DataFrame(found), "p_t", "marginal closer", "plain closer")
