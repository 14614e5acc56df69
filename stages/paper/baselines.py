"""What models are worth that nobody moved for: the paper's baselines, from the automatic protocol's data.

In: `protocol_recordings`, `active_recordings`, `points`, `hyperprior`, `scaling`, `learning_curve`, `bank` (a test set)
and `unseen_bank` (another one) where there is one. Out: `baseline_curve` and `baseline_comparison`. The baselines:

linear              the linear muscle law (paper, appendix D), after each trial of a sequence of the protocol
sparse_gp           a sparse GP on all samples of a sequence, with as many pseudo-inputs as the design has points
subset_gp           an exact GP on as many samples, drawn at random
linear_interactive  the linear law on all samples of the design's own trials: what interaction gives without a GP
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any

import numpy as np
import pandas as pd
from pydantic import Field, PositiveInt

from pipeline.config import Section
from pipeline.context import Context
from pipeline.errors import WiringError
from pipeline.stage import stage
from pipeline.table import Table, column
from stages.science.figures.canvas import LINES
from stages.science.figures.learning_curves import draw_error_bars, draw_learning_curves
from stages.science.gp.marginal import MarginalGP, fit
from stages.science.gp.sparse_fit import fit_sparse
from stages.science.gp.sparse_model import SparseGP
from stages.science.muscle_models.error_rates import ALL_MUSCLES, add_average, summarise_error_rates
from stages.science.muscle_models.linear_muscle import LinearMuscleModel
from stages.science.muscle_models.recorded_models import RecordedModels
from stages.science.signals.measures import error_rate
from stages.science.signals.scaling import MODEL_INPUTS, MODEL_OUTPUT, Array
from stages.science.statistics.groups import compare_groups
from stages.science.statistics.paired import compare_pairs
from stages.science.statistics.verdicts import LEVEL, judge_differences

NOBODY = "nobody"
LINEAR, SPARSE, SUBSET, INTERACTIVE = "linear", "sparse_gp", "subset_gp", "linear_interactive"
DESCRIBED = {
    LINEAR: "linear law, nobody moves",
    SPARSE: "sparse GP, nobody moves",
    SUBSET: "GP of a random subset, nobody moves",
    INTERACTIVE: "linear law, the design's trials",
}

BASELINE = column(str, "model, and the data that it is identified from", among=list(DESCRIBED))
TESTED_ON = column(str, "test set, as in learning_curve", among=["bank", "unseen_bank"])
BASELINE_CURVE = Table(
    "baseline_curve",
    "Error of a baseline's model of one muscle after one trial, over every sample of a test set",
    {
        "baseline": BASELINE,
        "participant": column(str, "who tracked, or nobody"),
        "experiment": column(int, "sequence of the protocol, or experiment of the participant", low=1),
        "trial": column(int, "trials learned from", low=1),
        "tested_on": TESTED_ON,
        "muscle": column(str, "muscle"),
        "rmse_n": column(float, "root mean square error of the force", unit="N", low=0),
        "error_rate": column(float, "the same over the largest force of the test data", low=0),
    },
    key=("baseline", "participant", "experiment", "trial", "tested_on", "muscle"),
)
BASELINE_COMPARISON = Table(
    "baseline_comparison",
    "The design against each baseline: error rate, negative = design better",
    {
        "tested_on": TESTED_ON,
        "measure": column(str, "final: after the last trial; curve: averaged over trials 1 to the last that both have"),
        "muscle": column(str, "muscle, or mean for the average over muscles"),
        "baseline": BASELINE,
        "n_design": column(int, "experiments of the design", low=1),
        "n_baseline": column(int, "of the baseline; the design's own for linear_interactive", low=1),
        "design_mean": column(float, "error rate", low=0),
        "baseline_mean": column(float, "error rate", low=0),
        "difference": column(float, "design minus baseline"),
        "low": column(float, "lower end of its 95 % interval (t)", nullable=True),
        "high": column(float, "upper end of its 95 % interval (t)", nullable=True),
        "test": column(str, "Welch between groups, or paired t over experiments", among=["Welch", "paired t"]),
        "effect": column(float, "effect size: Hedges g of groups, d_z of pairs", nullable=True),
        "p": column(float, "two-sided, of this test", low=0, high=1, nullable=True),
        "p_holm": column(float, "p adjusted by Holm over the rows of this test set", low=0, high=1, nullable=True),
        "verdict": column(str, f"at p_holm below {LEVEL}", among=["design better", "baseline better", "undecided"]),
    },
    key=("tested_on", "measure", "muscle", "baseline"),
    brief=("tested_on", "measure", "muscle", "baseline", "difference", "low", "high", "effect", "p_holm", "verdict"),
)


class Baselines(Section):
    """Config group ``baselines``."""

    experiments: PositiveInt
    slack_share: Annotated[float, Field(ge=0, lt=1)]
    sparse_starts: Annotated[int, Field(ge=1, le=100)]
    sparse_trial_iterations: Annotated[int, Field(ge=1, le=1000)]
    sparse_best_iterations: Annotated[int, Field(ge=0, le=1000)]
    starts: Annotated[int, Field(ge=0, le=1000)]


class Config(Section):
    """What this stage reads."""

    baselines: Baselines
    seed: int


@stage(BASELINE_CURVE, BASELINE_COMPARISON, stream="rivals")
def baselines(
    cfg: Config,
    bank: pd.DataFrame,
    hyperprior: pd.DataFrame,
    scaling: pd.DataFrame,
    points: pd.DataFrame,
    active_recordings: pd.DataFrame,
    protocol_recordings: pd.DataFrame,
    learning_curve: pd.DataFrame,
    ctx: Context,
    unseen_bank: pd.DataFrame | None = None,
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Identify the muscles from trials in which nobody moves, and compare the design with that."""
    if protocol_recordings.empty:
        raise WiringError(
            "stage baselines: protocol_recordings has no trials; add the stage protocol to workflow.stages"
        )
    design = str(learning_curve["arm"].iloc[0])
    ours = learning_curve[learning_curve["arm"] == design]
    tests = {"bank": bank} if unseen_bank is None else {"bank": bank, "unseen_bank": unseen_bank}
    passive = protocol_recordings[protocol_recordings["experiment"] <= cfg.baselines.experiments]
    interactive = active_recordings[active_recordings["arm"] == design]
    muscles = list(hyperprior["muscle"].unique())
    knowledge = [gather(each, hyperprior, scaling, tests, count_points(points, design)) for each in muscles]
    jobs = [Job(cfg.baselines, ctx, *each) for known in knowledge for each in split(known, passive, interactive)]
    rows: list[tuple[Any, ...]] = []
    with ctx.progress("models", len(jobs)) as advance:
        for job, found in zip(jobs, ctx.spread(Job.run, jobs), strict=True):
            rows += found
            advance(f"{job.participant} experiment {job.experiment} {job.muscle.name}")
    order = {name: position for position, name in enumerate(DESCRIBED)}
    curve = pd.DataFrame(rows, columns=list(BASELINE_CURVE.columns)).sort_values(
        list(BASELINE_CURVE.key),
        key=lambda values: values.map(order) if values.name == "baseline" else values,
        ignore_index=True,
    )
    draw(ctx, ours, curve, design, muscles)
    return curve, compare_baselines(ours, curve, muscles)


@dataclass(frozen=True, eq=False)
class MuscleData:
    """What is known of one muscle beside the samples that its models learn from.

    Parameters
    ----------
    name : str
        Of the muscle.
    recorded : RecordedModels
        Table 1, the mean of its GPs, centres and scales.
    tests : mapping of str to DataFrame
        Samples of each test set.
    points : int
        Of the design's model in the end.
    """

    name: str
    recorded: RecordedModels
    tests: Mapping[str, pd.DataFrame]
    points: int


def gather(
    muscle: str, hyperprior: pd.DataFrame, scaling: pd.DataFrame, tests: Mapping[str, pd.DataFrame], points: int
) -> MuscleData:
    """Return what is known of a muscle."""
    columns = [*MODEL_INPUTS, MODEL_OUTPUT]
    its_tests = {name: frame.loc[frame["muscle"] == muscle, columns] for name, frame in tests.items()}
    return MuscleData(muscle, RecordedModels.read(hyperprior, scaling, muscle), its_tests, points)


def count_points(points: pd.DataFrame, design: str) -> int:
    """Return how many points a muscle's model of the design stands on in the end."""
    its = points[points["arm"] == design]
    return int(its.groupby(["participant", "experiment", "muscle"]).size().max())


def split(
    known: MuscleData, passive: pd.DataFrame, interactive: pd.DataFrame
) -> Iterator[tuple[MuscleData, str, int, pd.DataFrame]]:
    """Yield muscle, participant, experiment and samples of each sequence of the protocol and experiment of the design.

    Those of the protocol come first, as they take longest.
    """
    for frame in (passive.assign(participant=NOBODY), interactive):
        samples = frame.loc[
            frame["muscle"] == known.name, ["participant", "experiment", "trial", *MODEL_INPUTS, MODEL_OUTPUT]
        ]
        for key, rows in samples.groupby(["participant", "experiment"], sort=False):
            yield known, str(key[0]), int(str(key[1])), rows


@dataclass(frozen=True, eq=False)
class Job:
    """All models of one muscle from one experiment, and their errors.

    Parameters
    ----------
    cfg : Baselines
        Searches and thresholds.
    ctx : Context
        For its generators.
    muscle : MuscleData
        What is known of it.
    participant : str
        ``nobody`` for a sequence of the protocol.
    experiment : int
        Sequence of the protocol, or experiment of the participant.
    samples : DataFrame
        What was recorded of the muscle, with its trial.
    """

    cfg: Baselines
    ctx: Context
    muscle: MuscleData
    participant: str
    experiment: int
    samples: pd.DataFrame

    def run(self) -> list[tuple[Any, ...]]:
        """Return the rows of `baseline_curve`."""
        trial = self.samples["trial"].to_numpy()
        last = int(trial.max())
        if self.participant != NOBODY:
            return self.measure(INTERACTIVE, last, self.fit_linear(self.samples))
        rows = []
        for each in np.unique(trial):
            rows += self.measure(LINEAR, int(each), self.fit_linear(self.samples[trial <= each]))
        rows += self.measure(SPARSE, last, self.fit_sparse())
        rows += self.measure(SUBSET, last, self.fit_subset())
        return rows

    def fit_linear(self, samples: pd.DataFrame) -> Predictor:
        """Fit the linear law to samples of the muscle that is not slack, by least squares."""
        model = fit_law(samples, self.cfg.slack_share)
        return lambda test: predict_law(model, test)

    def fit_sparse(self) -> Predictor:
        """Fit a sparse GP to all samples; pseudo-inputs and hyperparameters maximise the likelihood alone.

        Notes
        -----
        Snelson and Ghahramani, Sparse Gaussian processes using pseudo-inputs, NIPS 18 (2006).
        """
        known, trials = self.muscle, int(self.samples["trial"].nunique())
        count = min(known.points, len(self.samples))
        data = known.recorded.scaling.inputs_of(self.samples), known.recorded.scaling.output_of(self.samples)
        generator = self.ctx.generator(SPARSE, self.experiment, known.name)
        search = partial(fit_sparse, *data, count, None, known.recorded.mean, generator=generator)
        first = search(starts=self.cfg.sparse_starts, iterations=self.cfg.sparse_trial_iterations * trials)
        again = [(first.pseudo, first.theta)]
        best = search(starts=0, warm_starts=again, iterations=self.cfg.sparse_best_iterations * trials)
        return self.predict_with(best)

    def fit_subset(self) -> Predictor:
        """Fit an exact GP under the design's hyperprior to samples drawn at random."""
        known = self.muscle
        generator = self.ctx.generator(SUBSET, self.experiment, known.name)
        drawn = generator.choice(len(self.samples), min(known.points, len(self.samples)), replace=False)
        samples = self.samples.iloc[np.sort(drawn)]
        inputs, output = known.recorded.scaling.inputs_of(samples), known.recorded.scaling.output_of(samples)
        return self.predict_with(
            fit(inputs, output, known.recorded.prior, known.recorded.mean, generator=generator, starts=self.cfg.starts)
        )

    def predict_with(self, model: MarginalGP | SparseGP) -> Predictor:
        """Return the forces that a GP predicts."""
        scaling = self.muscle.recorded.scaling
        return lambda test: scaling.restore_force(model.predict_mean(scaling.inputs_of(test)))

    def measure(self, baseline: str, trial: int, predict: Predictor) -> list[tuple[Any, ...]]:
        """Return the rows of a model's errors on every test set."""
        rows = []
        for tested_on, test in self.muscle.tests.items():
            force = test[MODEL_OUTPUT].to_numpy()
            rate = error_rate(predict(test), force)
            where = (baseline, self.participant, self.experiment, trial, tested_on, self.muscle.name)
            rows.append((*where, rate * float(force.max()), rate))
        return rows


Predictor = Callable[[pd.DataFrame], Array]
"""A model in use: samples with columns `MODEL_INPUTS` to forces, N."""


def fit_law(samples: pd.DataFrame, slack_share: float) -> LinearMuscleModel:
    """Fit the linear law to samples of a muscle.

    Parameters
    ----------
    samples : DataFrame
        With columns `MODEL_INPUTS` and force_n.
    slack_share : float
        Samples whose force is below this share of the largest one are left out, as the law is that of a taut muscle.
    """
    force = samples[MODEL_OUTPUT].to_numpy()
    taut = samples[force >= slack_share * force.max()]
    return LinearMuscleModel.fit(
        taut["pressure_kpa"].to_numpy(), taut["contraction"].to_numpy(), taut[MODEL_OUTPUT].to_numpy()
    )


def predict_law(model: LinearMuscleModel, samples: pd.DataFrame) -> Array:
    """Return forces, N, none of them negative: where the law would have a muscle push, it is slack."""
    force = model.predict(samples["pressure_kpa"].to_numpy(), samples["contraction"].to_numpy())
    return np.maximum(force, 0.0)


def compare_baselines(design: pd.DataFrame, curve: pd.DataFrame, muscles: Sequence[str]) -> pd.DataFrame:
    """Return the rows of `baseline_comparison`.

    Parameters
    ----------
    design : DataFrame
        Rows of `learning_curve` of the design.
    curve : DataFrame
        Rows of `baseline_curve`.
    muscles : sequence of str
        To be compared one by one, after their average.
    """
    tests = design["tested_on"].unique()
    frames = [
        compare_family(design[design["tested_on"] == each], curve[curve["tested_on"] == each], muscles, str(each))
        for each in tests
    ]
    return pd.concat(frames, ignore_index=True)


def compare_family(design: pd.DataFrame, curve: pd.DataFrame, muscles: Sequence[str], tested_on: str) -> pd.DataFrame:
    """Return the rows of one test set, whose p-values are adjusted together."""
    design, curve = add_average(design), add_average(curve)
    rows = []
    for baseline, its in curve.groupby("baseline", sort=False):
        for measure in ("final", "curve") if baseline == LINEAR else ("final",):
            last = None if measure == "final" else int(min(design["trial"].max(), its["trial"].max()))
            ours, theirs = summarise_experiments(design, last), summarise_experiments(its, last)
            for muscle in [ALL_MUSCLES, *muscles]:
                where = {"tested_on": tested_on, "measure": measure, "muscle": muscle, "baseline": baseline}
                rows.append(where | compare(ours[muscle], theirs[muscle], paired=baseline == INTERACTIVE))
    frame = judge_differences(pd.DataFrame(rows), "p", "design better", "baseline better")
    return frame[list(BASELINE_COMPARISON.columns)]


def summarise_experiments(curve: pd.DataFrame, last: int | None) -> pd.DataFrame:
    """Return error rates by experiment (rows) and muscle (columns).

    Parameters
    ----------
    curve : DataFrame
        Of one method and test set, with the average over muscles.
    last : int or None
        Averaged over trials 1 to this one; None for the error rate after the last trial.
    """
    trial = curve["trial"]
    its = curve[trial == trial.max()] if last is None else curve[(trial >= 1) & (trial <= last)]
    return its.groupby(["participant", "experiment", "muscle"])["error_rate"].mean().unstack("muscle")


def compare(design: pd.Series[float], baseline: pd.Series[float], paired: bool) -> dict[str, Any]:
    """Return the statistics of one comparison: of the experiments that both have, or of two groups."""
    told: Any
    if paired:
        both = pd.concat([design, baseline], axis=1, join="inner").to_numpy()
        told = compare_pairs(both[:, 0], both[:, 1])
        counts, test, p = (told.n, told.n), "paired t", told.t_p_value
    else:
        told = compare_groups(np.asarray(design, dtype=float), np.asarray(baseline, dtype=float))
        counts, test, p = (told.n_first, told.n_second), "Welch", told.p_value
    return {
        "n_design": counts[0],
        "n_baseline": counts[1],
        "design_mean": told.mean_first,
        "baseline_mean": told.mean_second,
        "difference": told.difference,
        "low": told.low,
        "high": told.high,
        "test": test,
        "effect": told.effect_size,
        "p": p,
    }


def draw(ctx: Context, design: pd.DataFrame, curve: pd.DataFrame, arm: str, muscles: Sequence[str]) -> None:
    """Draw learning curves of the design and the linear law (paper, Fig. 6) and all errors in the end (Fig. 7)."""
    ours, linear = f"the design ({arm})", DESCRIBED[LINEAR]
    lines = pd.concat(
        [
            add_average(design).assign(line=ours),
            add_average(curve).assign(line=lambda frame: frame["baseline"].map(DESCRIBED)),
        ]
    )
    told = summarise_error_rates(lines, ["line", "trial", "tested_on", "muscle"])
    panels, tests = [ALL_MUSCLES, *muscles], list(design["tested_on"].unique())
    counts = [len(each.groupby(["participant", "experiment"])) for each in (design, curve[curve["baseline"] == LINEAR])]
    spread = f"mean and standard deviation over {counts[0]} experiments of the design, {counts[1]} of the protocol"
    ctx.figure(
        "learning_curves_baselines",
        draw_learning_curves(
            told[told["tested_on"] == "bank"], [ours, linear], panels, "line", None, LINES, apart=0.0, cut=True
        ),
        "Error rate (RMSE over the largest force of the test data) after each designed trial, and of the linear law "
        f"after each trial of the protocol in which nobody moves, tested on the bank: {spread} (cut where large).",
    )
    last = told[told["trial"] == told.groupby("line")["trial"].transform("max")]
    unseen = " Diamonds: tested on the bank that nothing else saw." if len(tests) > 1 else ""
    ctx.figure(
        "baseline_errors",
        draw_error_bars(last, [ours, *DESCRIBED.values()], panels),
        f"Error rate after the last trial, tested on the bank: {spread}.{unseen}",
    )
