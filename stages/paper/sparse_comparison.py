"""Whether keeping all samples pays: sparse models against exact ones, and designed choices against random ones.

In: `bank` (a test set, with force), `scaling`, `sparse_models`, `sparse_pseudo_inputs`, `learning_curve` (the exact
models' errors) and `unseen_bank` (another test set) where there is one. Out: `sparse_curve`, `sparse_comparison`.
Experiments are paired: both models begin with the same initial trials. This stage only reads.
"""

from collections.abc import Mapping
from itertools import product
from typing import Annotated, Any

import pandas as pd
from pydantic import Field

from pipeline.config import Section
from pipeline.context import Context
from pipeline.stage import stage
from pipeline.table import Table, column
from stages.science.figures.learning_curves import draw_learning_curves
from stages.science.gp.sparse_model import predict_weighted
from stages.science.muscle_models.error_rates import average_muscles, summarise_error_rates
from stages.science.muscle_models.samples import list_tests
from stages.science.signals.measures import error_rate
from stages.science.signals.scaling import Array, Scaling
from stages.science.statistics.equivalence import judge_paired_equivalence
from stages.science.statistics.paired import compare_pairs
from stages.science.statistics.verdicts import LEVEL, judge_with_equivalence, list_verdicts

KEEPING, CHOOSING = "keeping all samples", "choosing by utility"

MODEL = column(str, "sparse: of all samples; exact: of a trial's most informative ones", among=["sparse", "exact"])
TESTED_ON = column(str, "test set, as in learning_curve", among=["bank", "unseen_bank"])
SPARSE_CURVE = Table(
    "sparse_curve",
    "Error of one muscle's model after one trial over every sample of a test set, sparse and exact",
    {
        "participant": column(str, "who tracked"),
        "experiment": column(int, "experiment of this participant, in which both began with the same trials", low=1),
        "model": MODEL,
        "arm": column(str, "how trajectories were chosen"),
        "trial": column(int, "trials learned from; 0 = initial data alone", low=0),
        "tested_on": TESTED_ON,
        "muscle": column(str, "muscle"),
        "rmse_n": column(float, "root mean square error of the force", unit="N", low=0),
        "error_rate": column(float, "the same over the largest force of the test data", low=0),
    },
    key=("participant", "experiment", "model", "arm", "trial", "tested_on", "muscle"),
)
SPARSE_COMPARISON = Table(
    "sparse_comparison",
    "Two ways to learn, paired over experiments: mean error rate of muscles, negative = first better",
    {
        "tested_on": TESTED_ON,
        "question": column(str, "what the two differ in", among=[KEEPING, CHOOSING]),
        "measure": column(str, "final: after the last trial; curve: averaged over trials 1 to the last"),
        "first": column(str, "model and arm"),
        "second": column(str, "model and arm"),
        "n": column(int, "experiments", low=1),
        "first_mean": column(float, "error rate", low=0),
        "second_mean": column(float, "error rate", low=0),
        "difference": column(float, "first minus second"),
        "low": column(float, "lower end of its 95 % interval (t)", nullable=True),
        "high": column(float, "upper end of its 95 % interval (t)", nullable=True),
        "d_z": column(float, "effect size: difference over the SD of differences", nullable=True),
        "wins": column(int, "experiments in which the first is better", low=0),
        "p_t": column(float, "two-sided paired t-test", low=0, high=1, nullable=True),
        "p_wilcoxon": column(float, "two-sided Wilcoxon signed-rank test", low=0, high=1, nullable=True),
        "p_holm": column(float, "p_t adjusted by Holm over the rows of this test set", low=0, high=1, nullable=True),
        "margin": column(float, "largest difference of error rates that does not matter", low=0),
        "p_tost": column(float, "two one-sided paired tests of equivalence", low=0, high=1, nullable=True),
        "power": column(float, "of that test, were the true difference zero", low=0, high=1, nullable=True),
        "n_needed": column(float, "experiments for a power of 0.8", low=2, nullable=True),
        "verdict": column(
            str,
            f"better at p_holm below {LEVEL}, equivalent at p_tost below {LEVEL}, both, or neither",
            among=list_verdicts("first better", "second better"),
        ),
    },
    key=("tested_on", "question", "measure", "first", "second"),
    brief=("tested_on", "measure", "first", "second", "n", "difference", "low", "high", "d_z", "p_holm", "verdict"),
)


class SparseComparison(Section):
    """Config group ``sparse_comparison``."""

    margin: Annotated[float, Field(gt=0, le=1)]


class Config(Section):
    """What this stage reads."""

    sparse_comparison: SparseComparison


@stage(SPARSE_CURVE, SPARSE_COMPARISON)
def sparse_comparison(
    cfg: Config,
    bank: pd.DataFrame,
    scaling: pd.DataFrame,
    sparse_models: pd.DataFrame,
    sparse_pseudo_inputs: pd.DataFrame,
    learning_curve: pd.DataFrame,
    ctx: Context,
    unseen_bank: pd.DataFrame | None = None,
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Draw the learning curves of sparse and exact models and test what keeping and choosing gain."""
    tests = list_tests({"bank": bank, "unseen_bank": unseen_bank})
    jobs, who = {}, ["participant", "experiment"]
    for muscle in sparse_models["muscle"].unique():
        constants = Scaling.of_muscle(scaling, muscle)
        its_tests = {}
        for name, frame in tests.items():
            its = frame[frame["muscle"] == muscle]
            its_tests[name] = (constants.inputs_of(its), its["force_n"].to_numpy())
        its_models, its_pseudo = (each[each["muscle"] == muscle] for each in (sparse_models, sparse_pseudo_inputs))
        pseudo_of: dict[Any, pd.DataFrame] = dict(list(its_pseudo.groupby(who, sort=False)))
        for key, found in its_models.groupby(who, sort=False):
            where = str(key[0]), int(str(key[1])), str(muscle)
            jobs["{} experiment {} {}".format(*where)] = (*where, constants, its_tests, found, pseudo_of[key])
    rows = ctx.gather("experiments", measure_errors, jobs)
    curve = pd.DataFrame(rows, columns=list(SPARSE_CURVE.columns))
    if curve.empty:
        return curve, pd.DataFrame(columns=list(SPARSE_COMPARISON.columns))
    curve = join_exact(curve, learning_curve)
    labelled = label_lines(curve)
    lines, panels = list(labelled["line"].unique()), [f"average of the muscles, {name}" for name in tests]
    fewest = labelled.groupby("line")[who].apply(lambda its: len(its.drop_duplicates())).min()
    caption = (
        "Error rate (RMSE over the largest force of the test data, averaged over muscles) after each trial, of sparse "
        "models that keep all samples and of exact models of the most informative ones, for each test set: mean and "
        f"standard deviation over at least {fewest} experiments. Both begin with the same initial "
        "trials, of which the exact ones keep few samples."
    )
    told = summarise_error_rates(average_muscles(labelled), ["line", "trial", "tested_on"])
    told["muscle"] = "average of the muscles, " + told["tested_on"]
    ctx.figure("sparse_curve", draw_learning_curves(told, lines, panels, "line", "model and choice"), caption)
    return curve, compare_ways(curve, cfg.sparse_comparison.margin)


def measure_errors(
    participant: str,
    experiment: int,
    muscle: str,
    scaling: Scaling,
    tests: Mapping[str, tuple[Array, Array]],
    models: pd.DataFrame,
    pseudo_inputs: pd.DataFrame,
) -> list[tuple[Any, ...]]:
    """Return the rows of `sparse_curve` of one muscle's sparse models in one experiment, in all arms and trials."""
    rows = []
    pseudo_of: dict[Any, pd.DataFrame] = dict(list(pseudo_inputs.groupby(["arm", "trial"], sort=False)))
    for key, model in models.groupby(["arm", "trial"], sort=False):
        pseudo, theta = pseudo_of[key], model["value"].to_numpy()
        at, weights = scaling.inputs_of(pseudo), pseudo["weight"].to_numpy()
        for tested_on, (inputs, force_n) in tests.items():
            rate = error_rate(scaling.restore_force(predict_weighted(at, weights, theta, inputs)), force_n)
            where = participant, experiment, "sparse", *key, tested_on, muscle
            rows.append((*where, rate * float(force_n.max()), rate))
    return rows


def join_exact(measured: pd.DataFrame, learning_curve: pd.DataFrame) -> pd.DataFrame:
    """Return the sparse models' errors with the exact models' in the same experiments: the design and equal arms.

    In both, the design's arm comes first.
    """
    arms = [learning_curve["arm"].iloc[0], *measured["arm"].unique()]
    exact = learning_curve[learning_curve["arm"].isin(arms)]
    same = measured[["participant", "experiment", "tested_on"]].drop_duplicates()
    exact = exact.merge(same, on=list(same.columns), how="inner").assign(model="exact")
    return pd.concat([measured, exact[list(SPARSE_CURVE.columns)]], ignore_index=True)


def label_lines(curve: pd.DataFrame) -> pd.DataFrame:
    """Return the curve with model and arm in one column."""
    return curve.assign(line=curve["model"] + " " + curve["arm"])


def pair_lines(curve: pd.DataFrame) -> list[tuple[str, str, str]]:
    """Return question, first and second of every comparison: the designs, equal arms, and choices with sparse models.

    Where the exact models lack the sparse ones' design, theirs stands.
    """
    arms = {model: list(its["arm"].unique()) for model, its in curve.groupby("model", sort=False)}
    design, exact = arms["sparse"][0], arms.get("exact", [])
    baseline = design if design in exact else (exact or [None])[0]
    pairs = [(KEEPING, f"sparse {design}", f"exact {baseline}")] if baseline else []
    for arm in arms["sparse"][1:]:
        if arm in exact:
            pairs.append((KEEPING, f"sparse {arm}", f"exact {arm}"))
        pairs.append((CHOOSING, f"sparse {design}", f"sparse {arm}"))
    return pairs


def compare_ways(curve: pd.DataFrame, margin: float) -> pd.DataFrame:
    """Return the rows of `sparse_comparison`, from a curve with the design's arm first for either model."""
    frames = []
    for tested_on, its in average_muscles(label_lines(curve)).groupby("tested_on", sort=False):
        table = its.pivot_table(index=["participant", "experiment"], columns=["line", "trial"], values="error_rate")
        rows = []
        for measure, (question, first, second) in product(("final", "curve"), pair_lines(curve)):
            last = min(int(table[line].columns.max()) for line in (first, second))
            trials = [last] if measure == "final" else list(range(1, last + 1))
            both = pd.DataFrame({line: table[line][trials].to_numpy().mean(axis=1) for line in (first, second)})
            values = both.dropna()[first].to_numpy(), both.dropna()[second].to_numpy()
            where = {"tested_on": tested_on, "question": question, "measure": measure, "first": first, "second": second}
            rows.append(where | vars(compare_pairs(*values)) | vars(judge_paired_equivalence(*values, margin)))
        frames.append(judge_with_equivalence(pd.DataFrame(rows), "p_t", "first better", "second better"))
    return pd.concat(frames, ignore_index=True)[list(SPARSE_COMPARISON.columns)]
