"""What models are worth that nobody moved for: the paper's rivals, from the automatic protocol's data.

In: `protocol_recordings`, `active_recordings`, `points`, `learning_curve`, the test sets. Out: `rival_curve` and
`rival_comparison`. A rival is identified from one sequence of the protocol's trials:

linear              the linear parametric model (paper, appendix D), after each trial
sparse_gp           a sparse GP on all samples, with as many pseudo-inputs as the design has points (appendix E)
subset_gp           an exact GP on as many samples, drawn at random
linear_interactive  the linear model on all samples of the design's own trials: what interaction gives without a GP
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from pydantic import Field, PositiveInt

from pipeline.config import Section
from pipeline.context import Context
from pipeline.errors import PipelineError
from pipeline.stage import stage
from pipeline.table import Table, column
from stages.figures import draw_error_bars, draw_learning_curves
from stages.gp import fit, fit_sparse
from stages.identification import MuscleSet
from stages.parametric import LinearMuscleModel
from stages.signals import MODEL_OUTPUT, error_rate
from stages.statistics import adjust_holm, compare_groups, compare_pairs

Array = NDArray[np.float64]

ALL_MUSCLES = "mean"
NOBODY = "nobody"
LEVEL = 0.05
PASSIVE = ("linear", "sparse_gp", "subset_gp")
INTERACTIVE = "linear_interactive"
TOLD = {
    "linear": "linear, nobody moves",
    "sparse_gp": "sparse GP, nobody moves",
    "subset_gp": "GP on a subset, nobody moves",
    INTERACTIVE: "linear, same interaction",
}

RIVAL = column(str, "model and its data", among=[*PASSIVE, INTERACTIVE])
TESTED_ON = column(str, "test set, as in learning_curve", among=["bank", "unseen_bank"])
RIVAL_CURVE = Table(
    "rival_curve",
    "Error of one muscle's model of a rival after one trial, over every sample of a test set",
    {
        "rival": RIVAL,
        "participant": column(str, "who tracked, or nobody"),
        "experiment": column(int, "sequence of the protocol, or experiment of the participant", low=1),
        "trial": column(int, "trials learned from", low=1),
        "tested_on": TESTED_ON,
        "muscle": column(str, "muscle"),
        "rmse_n": column(float, "root mean square error of the force", unit="N", low=0),
        "error_rate": column(float, "the same over the largest force of the test data", low=0),
    },
    key=("rival", "participant", "experiment", "trial", "tested_on", "muscle"),
)
RIVAL_COMPARISON = Table(
    "rival_comparison",
    "The design against each rival: error rate, negative = design better",
    {
        "tested_on": TESTED_ON,
        "measure": column(str, "final: after the last trial; curve: averaged over trials 1 to the last"),
        "muscle": column(str, "muscle, or mean for the average over muscles"),
        "rival": RIVAL,
        "n_design": column(int, "experiments of the design", low=1),
        "n_rival": column(int, "of the rival; the same ones for linear_interactive", low=1),
        "design_mean": column(float, "error rate", low=0),
        "rival_mean": column(float, "error rate", low=0),
        "difference": column(float, "design minus rival"),
        "low": column(float, "lower end of its 95 % interval (t)", nullable=True),
        "high": column(float, "upper end of its 95 % interval (t)", nullable=True),
        "test": column(str, "Welch, between groups, or paired t over experiments", among=["Welch", "paired t"]),
        "effect": column(float, "Hedges g of groups, d_z of pairs", nullable=True),
        "p": column(float, "two-sided", low=0, high=1, nullable=True),
        "p_holm": column(float, "p adjusted by Holm over the rows of this test set", low=0, high=1, nullable=True),
        "verdict": column(str, f"at p_holm below {LEVEL}", among=["design better", "rival better", "undecided"]),
    },
    key=("tested_on", "measure", "muscle", "rival"),
    brief=("tested_on", "measure", "muscle", "rival", "difference", "low", "high", "effect", "p_holm", "verdict"),
)


class Rivals(Section):
    """Config group ``rivals``."""

    experiments: PositiveInt
    slack_share: Annotated[float, Field(ge=0, lt=1)]
    sparse_starts: Annotated[int, Field(ge=1, le=100)]
    sparse_iterations: Annotated[int, Field(ge=1, le=100_000)]
    starts: Annotated[int, Field(ge=0, le=1000)]


class Config(Section):
    """What this stage reads."""

    rivals: Rivals
    seed: int


@dataclass(frozen=True, eq=False)
class Data:
    """Samples of one muscle in one experiment, what models of it are tested on, and what they need to know.

    Parameters
    ----------
    participant : str
        Or nobody.
    experiment : int
        Sequence of the protocol, or experiment of the participant.
    muscle : int
        Position of the muscle.
    samples : DataFrame
        With trial.
    tests : dict of str to DataFrame
        The muscle's rows of each test set.
    points : int
        Of the design's models in the end.
    """

    participant: str
    experiment: int
    muscle: int
    samples: pd.DataFrame
    tests: dict[str, pd.DataFrame]
    points: int


@dataclass(frozen=True, eq=False)
class Identification:
    """How rivals are identified, the same for all jobs."""

    cfg: Rivals
    ctx: Context
    muscles: MuscleSet

    def run(self, data: Data) -> list[tuple[Any, ...]]:
        """Return the rows of `rival_curve` of one muscle in one experiment."""
        last = int(data.samples["trial"].max())
        if data.participant != NOBODY:
            return list(self.measure(data, INTERACTIVE, last, self.fit_linear(data, data.samples)))
        rows: list[tuple[Any, ...]] = []
        for trial in range(1, last + 1):
            model = self.fit_linear(data, data.samples[data.samples["trial"] <= trial])
            rows += self.measure(data, "linear", trial, model)
        rows += self.measure(data, "sparse_gp", last, self.fit_sparse(data))
        rows += self.measure(data, "subset_gp", last, self.fit_subset(data))
        return rows

    def fit_linear(self, data: Data, samples: pd.DataFrame) -> Predictor:
        """Fit the linear model to the samples of a muscle that is not slack."""
        force = samples[MODEL_OUTPUT].to_numpy()
        taut = force >= self.cfg.slack_share * data.samples[MODEL_OUTPUT].max()
        chosen = samples[taut] if taut.any() else samples
        inputs = (chosen[name].to_numpy() for name in ("pressure_kpa", "contraction", MODEL_OUTPUT))
        return LinearPredictor(LinearMuscleModel.fit(*inputs))

    def fit_sparse(self, data: Data) -> Predictor:
        """Fit the sparse GP to all samples; its hyperparameters maximise the likelihood alone, as in appendix E."""
        scaling = self.muscles.scalings[data.muscle]
        model = fit_sparse(
            scaling.inputs_of(data.samples),
            scaling.output_of(data.samples),
            min(data.points, len(data.samples)),
            None,
            self.muscles.mean,
            generator=self.generator("sparse_gp", data),
            starts=self.cfg.sparse_starts,
            iterations=self.cfg.sparse_iterations,
        )
        return GPPredictor(model, scaling)

    def fit_subset(self, data: Data) -> Predictor:
        """Fit the exact GP to samples drawn at random; Table 1 is its hyperprior, as the design's."""
        generator = self.generator("subset_gp", data)
        rows = generator.choice(len(data.samples), min(data.points, len(data.samples)), replace=False)
        samples, scaling = data.samples.iloc[np.sort(rows)], self.muscles.scalings[data.muscle]
        model = fit(
            scaling.inputs_of(samples),
            scaling.output_of(samples),
            self.muscles.priors[data.muscle],
            self.muscles.mean,
            generator=generator,
            starts=self.cfg.starts,
        )
        return GPPredictor(model, scaling)

    def generator(self, rival: str, data: Data) -> np.random.Generator:
        """Return the generator of one fit."""
        return self.ctx.generator(rival, data.experiment, self.muscles.names[data.muscle])

    def measure(self, data: Data, rival: str, trial: int, model: Predictor) -> Iterator[tuple[Any, ...]]:
        """Yield a model's errors on every test set."""
        for tested_on, test in data.tests.items():
            force = test[MODEL_OUTPUT].to_numpy()
            rate = error_rate(model.predict(test), force)
            where = (rival, data.participant, data.experiment, trial, tested_on, self.muscles.names[data.muscle])
            yield (*where, rate * float(force.max()), rate)


@stage(RIVAL_CURVE, RIVAL_COMPARISON)
def rivals(
    cfg: Config,
    bank: pd.DataFrame,
    candidates: pd.DataFrame,
    hyperprior: pd.DataFrame,
    scaling: pd.DataFrame,
    protocol_recordings: pd.DataFrame,
    active_recordings: pd.DataFrame,
    points: pd.DataFrame,
    learning_curve: pd.DataFrame,
    ctx: Context,
    unseen_bank: pd.DataFrame | None = None,
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Identify muscles without interaction, and compare the design with that."""
    if protocol_recordings.empty:
        raise PipelineError("protocol_recordings: expected trials, got none; raise protocol.experiments")
    muscles = MuscleSet.read(candidates, hyperprior, scaling)
    design = str(learning_curve["arm"].iloc[0])
    tests = {"bank": bank} if unseen_bank is None else {"bank": bank, "unseen_bank": unseen_bank}
    passive = protocol_recordings[protocol_recordings["experiment"] <= cfg.rivals.experiments]
    interactive = active_recordings[active_recordings["arm"] == design]
    jobs = list(gather(muscles, passive, interactive, tests, count_points(points, design)))
    identification = Identification(cfg.rivals, ctx, muscles)
    rows: list[tuple[Any, ...]] = []
    with ctx.progress("rivals", len(jobs)) as advance:
        for job, found in zip(jobs, ctx.spread(identification.run, jobs), strict=True):
            rows += found
            advance(f"{job.participant} experiment {job.experiment} {muscles.names[job.muscle]}")
    order = {name: position for position, name in enumerate(TOLD)}
    curve = pd.DataFrame(rows, columns=list(RIVAL_CURVE.columns)).sort_values(
        list(RIVAL_CURVE.key),
        key=lambda values: values.map(order) if values.name == "rival" else values,
        ignore_index=True,
    )
    draw(ctx, learning_curve[learning_curve["arm"] == design], curve, design, muscles.names)
    compared = [
        compare_family(its, curve[curve["tested_on"] == tested_on], muscles.names, str(tested_on))
        for tested_on, its in learning_curve[learning_curve["arm"] == design].groupby("tested_on", sort=False)
    ]
    return curve, pd.concat(compared, ignore_index=True)


@dataclass(frozen=True)
class LinearPredictor:
    """Forces by the linear law."""

    model: LinearMuscleModel

    def predict(self, samples: pd.DataFrame) -> Array:
        """Return forces, N; a muscle does not push, so that negative ones are none."""
        force = self.model.predict(samples["pressure_kpa"].to_numpy(), samples["contraction"].to_numpy())
        return np.maximum(force, 0.0)


@dataclass(frozen=True)
class GPPredictor:
    """Forces by a GP in standard units."""

    model: Any
    scaling: Any

    def predict(self, samples: pd.DataFrame) -> Array:
        """Return forces, N."""
        force: Array = self.scaling.restore_force(self.model.predict_mean(self.scaling.inputs_of(samples)))
        return force


Predictor = LinearPredictor | GPPredictor


def count_points(points: pd.DataFrame, design: str) -> int:
    """Return how many points the design's models stand on in the end."""
    its = points[points["arm"] == design]
    return int(its.groupby(["participant", "experiment", "muscle"]).size().max())


def gather(
    muscles: MuscleSet,
    passive: pd.DataFrame,
    interactive: pd.DataFrame,
    tests: dict[str, pd.DataFrame],
    points: int,
) -> Iterator[Data]:
    """Yield the data of every muscle and experiment, without and with interaction."""
    for position, name in enumerate(muscles.names):
        its_tests = {each: frame[frame["muscle"] == name] for each, frame in tests.items()}
        for experiment, samples in passive[passive["muscle"] == name].groupby("experiment"):
            yield Data(NOBODY, int(str(experiment)), position, samples, its_tests, points)
        who = ["participant", "experiment"]
        for key, samples in interactive[interactive["muscle"] == name].groupby(who, sort=False):
            yield Data(str(key[0]), int(str(key[1])), position, samples, its_tests, points)


def average_muscles(curve: pd.DataFrame) -> pd.DataFrame:
    """Return the curve with rows of the average over muscles."""
    keys = [name for name in curve.columns if name not in ("muscle", "rmse_n", "error_rate")]
    average = curve.groupby(keys, sort=False)["error_rate"].mean().reset_index().assign(muscle=ALL_MUSCLES)
    columns = [*keys, "muscle", "error_rate"]
    return pd.concat([curve[columns], average[columns]], ignore_index=True)


def compare_family(design: pd.DataFrame, curve: pd.DataFrame, muscles: Sequence[str], tested_on: str) -> pd.DataFrame:
    """Return the rows of `rival_comparison` of one test set, whose p-values are adjusted together.

    Parameters
    ----------
    design : DataFrame
        Rows of `learning_curve` of the design.
    curve : DataFrame
        Rows of `rival_curve`.
    muscles : sequence of str
        To be compared one by one, beside their average.
    tested_on : str
        Test set of both.
    """
    design, curve = average_muscles(design), average_muscles(curve)
    rows = []
    for rival in curve["rival"].unique():
        its = curve[curve["rival"] == rival]
        for measure in ("final", "curve") if its["trial"].max() > its["trial"].min() else ("final",):
            for muscle in [ALL_MUSCLES, *muscles]:
                ours, theirs = (measure_curve(each[each["muscle"] == muscle], measure) for each in (design, its))
                where = {"tested_on": tested_on, "measure": measure, "muscle": muscle, "rival": rival}
                rows.append({**where, **compare(ours, theirs, paired=rival == INTERACTIVE)})
    frame = pd.DataFrame(rows)
    adjusted = adjust_holm(frame["p"].to_numpy(dtype=float))
    better = np.where(frame["difference"] < 0, "design better", "rival better")
    frame = frame.assign(p_holm=adjusted, verdict=np.where(adjusted < LEVEL, better, "undecided"))
    return frame[list(RIVAL_COMPARISON.columns)]


def measure_curve(curve: pd.DataFrame, measure: str) -> pd.Series[float]:
    """Return each experiment's error rate after the last trial, or averaged over trials from 1."""
    its = curve[curve["trial"] == curve["trial"].max()] if measure == "final" else curve[curve["trial"] > 0]
    return its.groupby(["participant", "experiment"])["error_rate"].mean()


def compare(design: pd.Series[float], rival: pd.Series[float], paired: bool) -> dict[str, Any]:
    """Return the figures of one comparison."""
    if paired:
        both = pd.concat([design, rival], axis=1, join="inner").to_numpy()
        pairs = compare_pairs(both[:, 0], both[:, 1])
        counts, effect, p, test = (pairs.n, pairs.n), pairs.effect_size, pairs.t_p_value, "paired t"
        told: Any = pairs
    else:
        groups = compare_groups(np.array(design, dtype=float), np.array(rival, dtype=float))
        counts, effect, p, test = (groups.n_first, groups.n_second), groups.effect_size, groups.p_value, "Welch"
        told = groups
    return {
        "n_design": counts[0],
        "n_rival": counts[1],
        "design_mean": told.mean_first,
        "rival_mean": told.mean_second,
        "difference": told.difference,
        "low": told.low,
        "high": told.high,
        "test": test,
        "effect": effect,
        "p": p,
    }


def draw(ctx: Context, design: pd.DataFrame, curve: pd.DataFrame, name: str, muscles: Sequence[str]) -> None:
    """Draw both learning curves (paper, Fig. 6) and the errors in the end (Fig. 7)."""
    ours = f"interaction, {name}"
    lines = pd.concat(
        [
            average_muscles(design).assign(line=ours),
            average_muscles(curve).assign(line=lambda frame: frame["rival"].map(TOLD)),
        ],
        ignore_index=True,
    )
    told = lines.groupby(["line", "trial", "tested_on", "muscle"])["error_rate"].agg(["mean", "std"]).reset_index()
    told = told.rename(columns={"mean": "error_rate_mean", "std": "error_rate_sd"})
    panels = [ALL_MUSCLES, *muscles]
    figure = draw_learning_curves(
        told[told["tested_on"] == "bank"], [ours, TOLD["linear"]], panels, "line", "identified by"
    )
    caption = (
        "Error rate after each designed trial, and of the linear model after each trial of the automatic protocol in "
        "which nobody moves: mean and standard deviation over experiments, tested on the bank."
    )
    ctx.figure("learning_curves_rivals", figure, caption)
    last = told[told["trial"] == told["trial"].max()]
    caption = "Error rate after the last trial: mean and standard deviation over experiments, tested on the bank" + (
        "; diamonds: on the unseen bank." if "unseen_bank" in set(told["tested_on"]) else "."
    )
    ctx.figure("rival_errors", draw_error_bars(last, [ours, *TOLD.values()], panels), caption)
