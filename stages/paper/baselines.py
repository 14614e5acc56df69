"""What models are worth that nobody moved for: the paper's baselines, from the automatic protocol's data.

In: `protocol_recordings`, `active_recordings`, `points`, `hyperprior`, `scaling`, `learning_curve`, `bank` (a test set)
and `unseen_bank` (another one) where there is one. Out: `baseline_curve` and `baseline_comparison`. The baselines:

linear              the linear muscle law (paper, appendix D), after each trial of a sequence of the protocol
sparse_gp           a sparse GP on all samples of a sequence, with as many pseudo-inputs as the design has points
subset_gp           an exact GP on as many samples, drawn at random
linear_interactive  the linear law on all samples of the design's own trials: what interaction gives without a GP
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any, ClassVar

import numpy as np
import pandas as pd
from pydantic import Field, PositiveInt

from pipeline.config import Section, View
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
from stages.science.muscle_models.inputs import MeasuredInputs
from stages.science.muscle_models.linear_muscle import LinearMuscleModel
from stages.science.muscle_models.muscle_set import RecordedModels
from stages.science.muscle_models.samples import list_tests
from stages.science.signals.lead_in import leave_out_lead_in
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
        "error_rate": column(float, "the same over the largest force of the test data", percent=True, low=0),
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
        "design_mean": column(float, "error rate", percent=True, low=0),
        "baseline_mean": column(float, "error rate", percent=True, low=0),
        "difference": column(float, "design minus baseline", percent=True),
        "low": column(float, "lower end of its 95 % interval (t)", percent=True, nullable=True),
        "high": column(float, "upper end of its 95 % interval (t)", percent=True, nullable=True),
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


class ModelServed(View):
    """The design's model has the inputs that baselines take."""

    model: MeasuredInputs


class Config(Section):
    """What this stage reads."""

    checks: ClassVar = (ModelServed,)

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
    tests = list_tests({"bank": bank, "unseen_bank": unseen_bank})
    passive, designed = (leave_out_lead_in(each) for each in (protocol_recordings, active_recordings))
    passive = passive[passive["experiment"] <= cfg.baselines.experiments]
    interactive = designed[designed["arm"] == design]
    muscles = list(hyperprior["muscle"].unique())
    count, columns = count_points(points, design), [*MODEL_INPUTS, MODEL_OUTPUT]
    jobs = {}
    for name in muscles:
        its_tests = {test: frame.loc[frame["muscle"] == name, columns] for test, frame in tests.items()}
        known = name, RecordedModels.read(hyperprior, scaling, name), its_tests, count
        for frame in (passive.assign(participant=NOBODY), interactive):  # the protocol's first, as they take longest
            samples = frame.loc[frame["muscle"] == name, ["participant", "experiment", "trial", *columns]]
            for key, rows_of_one in samples.groupby(["participant", "experiment"], sort=False):
                job = Job(cfg.baselines, ctx, *known, str(key[0]), int(str(key[1])), rows_of_one)
                jobs[f"{job.participant} experiment {job.experiment} {name}"] = (job,)
    rows = ctx.gather("models", Job.run, jobs)
    curve = pd.DataFrame(rows, columns=list(BASELINE_CURVE.columns)).sort_values(
        list(BASELINE_CURVE.key),
        key=lambda values: pd.Categorical(values, list(DESCRIBED)) if values.name == "baseline" else values,
        ignore_index=True,
    )
    draw(ctx, ours, curve, design, muscles)
    return curve, compare_baselines(ours, curve, muscles)


def count_points(points: pd.DataFrame, design: str) -> int:
    """Return how many points a muscle's model of the design stands on in the end."""
    its = points[points["arm"] == design]
    return int(its.groupby(["participant", "experiment", "muscle"]).size().max())


@dataclass(frozen=True, eq=False)
class Job:
    """All models of one muscle from one experiment, or from a sequence of the protocol (of ``nobody``).

    Its GPs stand on as many `points` as the design's model in the end.
    """

    cfg: Baselines
    ctx: Context
    muscle: str
    recorded: RecordedModels
    tests: Mapping[str, pd.DataFrame]
    points: int
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
        rows += self.measure(SPARSE, last, self.predict_with(self.fit_sparse()))
        rows += self.measure(SUBSET, last, self.predict_with(self.fit_subset()))
        return rows

    def fit_linear(self, samples: pd.DataFrame) -> Predictor:
        """Fit the linear law to samples of the muscle that is not slack, by least squares."""
        return partial(predict_law, fit_law(samples, self.cfg.slack_share))

    def fit_sparse(self) -> SparseGP:
        """Fit a sparse GP to all samples; pseudo-inputs and hyperparameters maximise the likelihood alone.

        Source: Snelson and Ghahramani, Sparse Gaussian processes using pseudo-inputs, NIPS 18 (2006).
        """
        known, trials = self.recorded, int(self.samples["trial"].nunique())
        data = known.scaling.inputs_of(self.samples), known.scaling.output_of(self.samples)
        count = min(self.points, len(self.samples))
        generator = self.ctx.generator(SPARSE, self.experiment, self.muscle)
        search = partial(fit_sparse, *data, count, None, known.mean, generator=generator)
        first = search(starts=self.cfg.sparse_starts, iterations=self.cfg.sparse_trial_iterations * trials)
        again = [(first.pseudo, first.theta)]
        return search(starts=0, warm_starts=again, iterations=self.cfg.sparse_best_iterations * trials)

    def fit_subset(self) -> MarginalGP:
        """Fit an exact GP under the design's hyperprior to samples drawn at random."""
        known, count = self.recorded, len(self.samples)
        generator = self.ctx.generator(SUBSET, self.experiment, self.muscle)
        drawn = generator.choice(count, min(self.points, count), replace=False)
        samples = self.samples.iloc[np.sort(drawn)]
        inputs, output = known.scaling.inputs_of(samples), known.scaling.output_of(samples)
        return fit(inputs, output, known.prior, known.mean, generator=generator, starts=self.cfg.starts)

    def predict_with(self, model: MarginalGP | SparseGP) -> Predictor:
        """Return the forces that a GP predicts."""
        scaling = self.recorded.scaling
        return lambda test: scaling.restore_force(model.predict_mean(scaling.inputs_of(test)))

    def measure(self, baseline: str, trial: int, predict: Predictor) -> list[tuple[Any, ...]]:
        """Return the rows of a model's errors on every test set."""
        rows = []
        for tested_on, test in self.tests.items():
            force = test[MODEL_OUTPUT].to_numpy()
            rate = error_rate(predict(test), force)
            where = (baseline, self.participant, self.experiment, trial, tested_on, self.muscle)
            rows.append((*where, rate * float(force.max()), rate))
        return rows


Predictor = Callable[[pd.DataFrame], Array]
"""A model in use: samples with columns `MODEL_INPUTS` to forces, N."""


def fit_law(samples: pd.DataFrame, slack_share: float) -> LinearMuscleModel:
    """Fit the linear law to the samples of a muscle whose force is at least this share of the largest one.

    The law is that of a taut muscle.
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
    """Return the rows of `baseline_comparison`, of each test set the muscles' average first, then one by one.

    They come from the rows of `learning_curve` of the design, and of `baseline_curve`.
    """
    frames = [
        compare_family(design[design["tested_on"] == each], curve[curve["tested_on"] == each], muscles, str(each))
        for each in design["tested_on"].unique()
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
    """Return error rates by experiment and muscle: averaged over trials 1 to `last`, or after the last one if None."""
    trial = curve["trial"]
    its = curve[trial == trial.max()] if last is None else curve[(trial >= 1) & (trial <= last)]
    return its.groupby(["participant", "experiment", "muscle"])["error_rate"].mean().unstack("muscle")


def compare(design: pd.Series[float], baseline: pd.Series[float], paired: bool) -> dict[str, Any]:
    """Return the statistics of one comparison: of the experiments that both have, or of two groups."""
    if paired:
        both = pd.concat([design, baseline], axis=1, join="inner").to_numpy()
        pairs = compare_pairs(both[:, 0], both[:, 1])
        row = {**vars(pairs), "n_design": pairs.n, "n_baseline": pairs.n, "effect": pairs.d_z, "p": pairs.p_t}
    else:
        told = compare_groups(np.asarray(design, dtype=float), np.asarray(baseline, dtype=float))
        row = {**vars(told), "n_design": told.n_first, "n_baseline": told.n_second}
        row |= {"effect": told.hedges_g, "p": told.p_welch}
    means = {"design_mean": row["first_mean"], "baseline_mean": row["second_mean"]}
    return {**row, **means, "test": "paired t" if paired else "Welch"}


def draw(ctx: Context, design: pd.DataFrame, curve: pd.DataFrame, arm: str, muscles: Sequence[str]) -> None:
    """Draw learning curves of the design and the linear law (paper, Fig. 6) and all errors in the end (Fig. 7)."""
    ours, linear = f"the design ({arm})", DESCRIBED[LINEAR]
    theirs = add_average(curve)
    lines = pd.concat([add_average(design).assign(line=ours), theirs.assign(line=theirs["baseline"].map(DESCRIBED))])
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
