"""Learning curves of every arm on measured forces, paired tests of the design against each control, and an advice.

In: `bank` (a test set, with force), `hyperprior`, `scaling`, `models`, `points`, `trials`, and `unseen_bank` and
`task_movements` (further test sets) where there are some. Out: `learning_curve`, `learning_summary`, `final_errors`,
`paired_comparison`, and in words `learning_findings` and `advice`.
This stage only reads: it chooses and measures nothing.
"""

from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from typing import Annotated, Any

import pandas as pd
from pydantic import Field, PositiveInt

from pipeline.config import Section
from pipeline.context import Context
from pipeline.printing import format_p
from pipeline.stage import stage
from pipeline.table import Table, column, sentences
from stages.science.figures.canvas import spell_arm
from stages.science.figures.learning_curves import MOST_BARS, draw_learning_curves
from stages.science.gp.marginal import MarginalGP
from stages.science.muscle_models.error_rates import ALL_MUSCLES, ENDED, average_muscles, carry_forward
from stages.science.muscle_models.inputs import ModelSettings
from stages.science.muscle_models.muscle_set import ExperimentModels, RecordedModels
from stages.science.muscle_models.samples import gather_tests, keep_wanted
from stages.science.signals.measures import error_rate
from stages.science.signals.scaling import Array
from stages.science.statistics.paired import compare_pairs
from stages.science.statistics.verdicts import LEVEL, judge_differences

DESCRIBED = {
    "bank": "the bank that trials were chosen from",
    "unseen_bank": "a second bank that nothing else saw",
    "task": "the task, the movements that models are wanted for",
}

UNDECIDED = "undecided"
SHOWN_ORDER = ("task", "unseen_bank", "bank")
"""Test sets, the one that matters most first."""
WAYS = {
    "integrated_variance": "by how much it lowers the variance expected over what models are wanted for",
    "y_y": "the paper's, by what a new measurement tells of the model",
    "variance": "by the variance of its predictions",
    "random": "by chance",
}
ARM = column(str, "how trajectories were chosen")
TESTED_ON = column(
    str,
    "bank: the movements that trials were chosen from; unseen_bank: movements that nothing else saw; task: those that "
    "models are wanted for",
    among=["bank", "unseen_bank", "task"],
)
LEARNING_CURVE = Table(
    "learning_curve",
    "Error of one muscle's model after one trial, over every sample of a test set",
    {
        "participant": column(str, "who tracked"),
        "experiment": column(int, "experiment of this participant", low=1),
        "arm": ARM,
        "trial": column(int, "trials learned from; 0 = initial data alone", low=0),
        "tested_on": TESTED_ON,
        "muscle": column(str, "muscle"),
        "rmse_n": column(float, "root mean square error of the force", unit="N", low=0),
        "error_rate": column(float, "the same over the largest force of the test data", percent=True, low=0),
    },
    key=("participant", "experiment", "arm", "trial", "tested_on", "muscle"),
)
LEARNING_SUMMARY = Table(
    "learning_summary",
    "Error rate after each trial over the experiments that every arm has",
    {
        "tested_on": TESTED_ON,
        "arm": ARM,
        "trial": column(int, "trials learned from", low=0),
        "muscle": column(str, "muscle, or mean for the average over muscles"),
        "error_rate_mean": column(float, "mean over experiments", percent=True, low=0),
        "error_rate_sd": column(float, "standard deviation over experiments", percent=True, low=0, nullable=True),
        "experiments": column(int, "how many", low=1),
    },
    key=("tested_on", "arm", "trial", "muscle"),
)
FINAL_ERRORS = Table(
    "final_errors",
    "Error rate before and after the designed trials (RMSE / largest test force; mean and SD over experiments)",
    {
        "tested_on": TESTED_ON,
        "muscle": column(str, "muscle, or mean for the average over muscles"),
        "arm": ARM,
        "before": column(float, "mean error rate of the initial data alone", percent=True, low=0),
        "after": column(float, "mean error rate after the last trial", percent=True, low=0),
        "after_sd": column(
            float, "standard deviation of the latter over experiments", percent=True, low=0, nullable=True
        ),
        "experiments": column(int, "how many", low=1),
        "trials": column(
            float, "trials that were executed, mean over experiments, where active_loop.until is set", optional=True
        ),
    },
    key=("tested_on", "muscle", "arm"),
    brief=("tested_on", "arm", "before", "after", "after_sd"),
    main=("muscle", ALL_MUSCLES),
)
PAIRED_COMPARISON = Table(
    "paired_comparison",
    "The design against each control, paired over experiments: mean error rate of muscles, negative = design better",
    {
        "tested_on": TESTED_ON,
        "measure": column(str, "final: after the last trial; curve: averaged over trials 1 to the last"),
        "design": column(str, "arm"),
        "control": column(str, "arm"),
        "n": column(int, "experiments", low=1),
        "design_mean": column(float, "error rate", percent=True, low=0),
        "control_mean": column(float, "error rate", percent=True, low=0),
        "difference": column(float, "design minus control", percent=True),
        "low": column(float, "lower end of its 95 % interval (t)", percent=True, nullable=True),
        "high": column(float, "upper end of its 95 % interval (t)", percent=True, nullable=True),
        "d_z": column(float, "effect size: difference over the SD of differences", nullable=True),
        "wins": column(int, "experiments in which the design is better", low=0),
        "p_t": column(float, "two-sided paired t-test", low=0, high=1, nullable=True),
        "p_wilcoxon": column(float, "two-sided Wilcoxon signed-rank test", low=0, high=1, nullable=True),
        "p_holm": column(
            float, "p_t raised (Holm) as all rows of this test set and n are compared", low=0, high=1, nullable=True
        ),
        "verdict": column(str, f"at p_holm below {LEVEL}", among=["design better", "control better", UNDECIDED]),
    },
    key=("tested_on", "measure", "design", "control", "n"),
    brief=("tested_on", "control", "difference", "p_holm", "verdict"),
    main=("measure", "final"),
)
LEARNING_FINDINGS = sentences("learning_findings", "finding")
ADVICE = sentences("advice", "advice")


class Comparison(Section):
    """Config group ``comparison``."""

    experiments: Annotated[list[PositiveInt | None], Field(min_length=1)]


class Config(Section):
    """What this stage reads."""

    comparison: Comparison
    model: ModelSettings


@stage(LEARNING_CURVE, LEARNING_SUMMARY, FINAL_ERRORS, PAIRED_COMPARISON, LEARNING_FINDINGS, ADVICE)
def comparison(
    cfg: Config,
    bank: pd.DataFrame,
    hyperprior: pd.DataFrame,
    scaling: pd.DataFrame,
    models: pd.DataFrame,
    points: pd.DataFrame,
    trials: pd.DataFrame,
    ctx: Context,
    unseen_bank: pd.DataFrame | None = None,
    task_movements: pd.DataFrame | None = None,
) -> tuple[pd.DataFrame, ...]:
    """Draw the learning curves of every arm and test the design against each control."""
    muscles, arms = list(hyperprior["muscle"].unique()), list(models["arm"].unique())
    given = {"bank": bank, "unseen_bank": unseen_bank, "task": task_movements}
    tests = {name: keep_wanted(each) for name, each in gather_tests(cfg.model, given).items()}
    recorded = {name: RecordedModels.read(hyperprior, scaling, name) for name in muscles}
    tests_of: dict[str, dict[str, tuple[Array, Array]]] = {name: {} for name in muscles}
    for muscle, (name, frame) in product(muscles, tests.items()):
        its = frame[frame["muscle"] == muscle]
        tests_of[muscle][name] = recorded[muscle].scaling.inputs_of(its), its["force_n"].to_numpy()
    learned = ExperimentModels.split(recorded, models, points)
    rows = ctx.gather("experiments", measure_errors, {note: (it, tests_of[it.muscle]) for note, it in learned.items()})
    curve = pd.DataFrame(rows, columns=list(LEARNING_CURVE.columns)).sort_values(
        list(LEARNING_CURVE.key),
        key=lambda values: pd.Categorical(values, arms) if values.name == "arm" else values,
        ignore_index=True,
    )
    kept = keep_common(curve, len(arms))
    common = carry_forward(kept)
    summary = summarise(common, list(tests), arms, muscles)
    shown = [name for name in SHOWN_ORDER if name in tests]
    told = f"{'' if common is kept else ENDED} {describe_arms(arms)}"
    experiments = int(summary["experiments"].max())
    caption = (
        f"Error rate (RMSE over the largest force of the test data) after each trial, mean and standard deviation"
        f"{f' (of {spell_arm(arms[0])})' if len(arms) > MOST_BARS else ''} over {experiments} "
        f"experiment{'s' * (experiments > 1)}. Trial 0 is the "
        "initial data, the same for every arm"
    )
    mean = summary[summary["muscle"] == ALL_MUSCLES]
    figure = draw_learning_curves(mean.assign(muscle=mean["tested_on"]), arms, shown)
    ctx.figure("learning_curve", figure, f"{caption}; average of the muscles.{told}")
    its = summary[summary["tested_on"] == shown[0]]
    figure = draw_learning_curves(its, arms, muscles)
    ctx.figure("learning_curve_muscles", figure, f"{caption}; each muscle, tested on {DESCRIBED[shown[0]]}.{told}")
    compared = pair_arms(common, arms, cfg.comparison.experiments)
    final = describe_final_errors(summary, list(tests), arms, muscles)
    if {"expected_below", "expected_next"} & set(trials.columns):
        executed = kept.groupby(["arm", "participant", "experiment"])["trial"].max()
        final["trials"] = final["arm"].map(executed.groupby("arm").mean())
    largest = compared[compared["n"] == compared["n"].max()]
    said = describe_learning(final, mean, largest, shown, arms[0]), advise(largest, shown[0], arms)
    return curve, summary, final, compared, *(pd.DataFrame({"sentence": each}) for each in said)


def measure_errors(learned: ExperimentModels, tests: Mapping[str, tuple[Array, Array]]) -> list[tuple[Any, ...]]:
    """Return the rows of `learning_curve` of one muscle in one experiment, in all arms and after all trials."""

    def tell(gp: MarginalGP) -> Iterator[tuple[Any, ...]]:
        for tested_on, (inputs, force_n) in tests.items():
            rate = error_rate(learned.recorded.scaling.restore_force(gp.predict_mean(inputs)), force_n)
            yield tested_on, learned.muscle, rate * float(force_n.max()), rate

    return learned.measure(tell)


def keep_common(curve: pd.DataFrame, arms: int) -> pd.DataFrame:
    """Return the rows of the experiments that every arm has, so that arms are compared on the same ones."""
    counted = curve.groupby(["participant", "experiment"])["arm"].transform("nunique")
    return curve[counted == arms]


def summarise(curve: pd.DataFrame, tests: Sequence[str], arms: Sequence[str], muscles: Sequence[str]) -> pd.DataFrame:
    """Return mean and SD over experiments, for each muscle and for their average."""
    rows = pd.concat([curve, average_muscles(curve)], ignore_index=True)
    grouped = rows.groupby(["tested_on", "arm", "trial", "muscle"])["error_rate"].agg(["mean", "std", "count"])
    keys = list(product(tests, arms, sorted(curve["trial"].unique()), [*muscles, ALL_MUSCLES]))
    return grouped.loc[keys].reset_index().set_axis(list(LEARNING_SUMMARY.columns), axis="columns")


def describe_final_errors(
    summary: pd.DataFrame, tests: Sequence[str], arms: Sequence[str], muscles: Sequence[str]
) -> pd.DataFrame:
    """Return the rows of `final_errors`."""
    keys = ["tested_on", "muscle", "arm"]
    before = summary[summary["trial"] == 0].set_index(keys)
    after = summary[summary["trial"] == summary["trial"].max()].set_index(keys)
    found = after.rename(columns={"error_rate_mean": "after", "error_rate_sd": "after_sd"})
    found = found.assign(before=before["error_rate_mean"])[["before", "after", "after_sd", "experiments"]]
    return found.loc[list(product(tests, [*muscles, ALL_MUSCLES], arms))].reset_index()


def pair_arms(curve: pd.DataFrame, arms: Sequence[str], sizes: Sequence[int | None]) -> pd.DataFrame:
    """Return the rows of `paired_comparison`: the first arm, the design, against each other one.

    Each size is a family of tests: so many experiments of each participant count, or all where it is None.
    """
    ranks = curve.groupby("participant")["experiment"].rank(method="dense")
    taken = [ranks <= (ranks.max() if size is None else size) for size in sizes]
    distinct = {int(rows.sum()): rows for rows in taken}
    frames = []
    for tested_on, chosen in product(curve["tested_on"].unique(), distinct.values()):
        family = average_muscles(curve[chosen & (curve["tested_on"] == tested_on)])
        table = family.pivot_table(index=["participant", "experiment"], columns=["arm", "trial"], values="error_rate")
        last = family["trial"].max()
        measures = {
            "final": {arm: table[arm][last].to_numpy() for arm in arms},
            "curve": {arm: table[arm].drop(columns=0).to_numpy().mean(axis=1) for arm in arms},
        }
        where = {"tested_on": tested_on, "design": arms[0]}
        rows = [
            {**where, "measure": measure, "control": control}
            | compare_pairs(values[arms[0]], values[control]).tabulate("design", "control")
            for measure, values in measures.items()
            for control in arms[1:]
        ]
        frame = pd.DataFrame(rows, columns=list(PAIRED_COMPARISON.columns)[:-2])
        frames.append(judge_differences(frame, "p_t", "design better", "control better"))
    return pd.concat(frames, ignore_index=True)


def describe_arms(arms: Sequence[str]) -> str:
    """Return what the names of arms mean, as far as a sentence can tell."""
    told = [f"{spell_arm(name)}: {WAYS[name]}" for name in arms if name in WAYS]
    return f"How the next trajectory is chosen (an arm): {'; '.join(told)}." if told else ""


def describe_learning(
    final: pd.DataFrame, mean: pd.DataFrame, compared: pd.DataFrame, tests: Sequence[str], design: str
) -> list[str]:
    """Return what the design's models came to on each test set, and how that compares with each control on the first.

    `compared` has the rows of the largest number of experiments, `mean` those of `learning_summary` over all muscles.
    """
    rows = final[final["muscle"] == ALL_MUSCLES]
    if "trials" not in rows:
        rows = rows.assign(trials=float(mean["trial"].max()))
    its = {str(row["tested_on"]): row for row in rows[rows["arm"] == design].to_dict("records")}
    executed = rows[rows["tested_on"] == tests[0]].set_index("arm")["trials"].to_dict()
    first, trials = its[tests[0]], int(mean["trial"].max())
    n = int(first["experiments"])
    spread = f", standard deviation {_percent(first['after_sd'])}" if n > 1 else ""
    kind = "random" if design == "random" else "designed"
    text = (
        f"After {_count_trials(executed[design], trials, f'{kind} ')} the models err by {_percent(first['after'])} of "
        f"the largest force on {DESCRIBED[tests[0]]} ({n} experiment{'s' * (n > 1)}{spread}); before them it was "
        f"{_percent(first['before'])}."
    )
    others = [f"{_percent(its[name]['after'])} on {DESCRIBED[name]}" for name in tests[1:]]
    told = [f"{text} They err by {' and by '.join(others)}." if others else text]
    curves = mean[mean["tested_on"] == tests[0]].pivot_table(index="trial", columns="arm", values="error_rate_mean")
    pairs = compared[(compared["tested_on"] == tests[0]) & (compared["measure"] == "final")]
    for row in pairs[pairs["verdict"] != UNDECIDED].to_dict("records"):
        reached = curves.index[(curves[design] <= curves[row["control"]].iloc[-1]).to_numpy()]
        told.append(_compare_with(row, reached, trials, _say_after(executed, row["control"], trials)))
    left = pairs[pairs["verdict"] == UNDECIDED].to_dict("records")
    if left:
        ends = [
            f"{choose_by(row['control'])} ({_percent(row['control_mean'])}"
            f"{_say_after(executed, row['control'], trials)})"
            for row in left
        ]
        least = min((row["p_holm"] for row in left if not pd.isna(row["p_holm"])), default=None)
        doubt = "so few experiments tell nothing of chance" if least is None else f"p = {least:.2g} or more"
        told.append(f"Not told apart from trajectories chosen {' or '.join(ends)}: {doubt}.")
    better = compared[(compared["measure"] == "final") & (compared["verdict"] == "control better")]
    for row in better[better["tested_on"].isin(tests[1:])].to_dict("records"):
        told.append(
            f"On {DESCRIBED[row['tested_on']]}, those chosen {choose_by(row['control'])} end {_describe_lead(row)}."
        )
    return told


def choose_by(arm: str) -> str:
    """Return how trajectories are chosen in an arm, as it stands behind *chosen*."""
    return "at random" if arm == "random" else f"by {spell_arm(arm)}"


def _count_trials(executed: float, most: int, kind: str = "") -> str:
    """Return how many trials were executed, of `most`, on average where some experiments ended before."""
    return f"{round(executed, 1):g} {kind}trial{'s' * (executed != 1)}{' on average' * (executed < most)}"


def _say_after(executed: Mapping[Any, float], arm: str, most: int) -> str:
    """Return after how many trials an arm ended, where experiments of some arm ended before the last."""
    return f" after {_count_trials(executed[arm], most)}" if min(executed.values()) < most else ""


def _compare_with(row: Mapping[Any, Any], reached: pd.Index, trials: int, after: str) -> str:
    """Return how a control ended that differs from the design, by a row of `paired_comparison`."""
    text = f"With trajectories chosen {choose_by(row['control'])} they end at {_percent(row['control_mean'])}{after}"
    if row["verdict"] == "control better":
        return f"{text}, which is {_describe_lead(row)}."
    when = f", and reaches that error by trial {int(reached[0])} of {trials}" if len(reached) else ""
    design = "chance" if row["design"] == "random" else f"the design ({spell_arm(row['design'])})"
    return f"{text}: {design} is {_describe_lead(row)}{when}."


def _describe_lead(row: Mapping[Any, Any]) -> str:
    ends = sorted(abs(100 * row[name]) for name in ("low", "high"))
    doubt = f"95 % interval {ends[0]:.2g} to {ends[1]:.2g}, {format_p(row['p_holm'])}, paired over experiments"
    lead = f"{100 * abs(row['difference']):.2g}"
    return f"better by {lead} point{'s' * (lead != '1')} ({doubt})"


def advise(compared: pd.DataFrame, tested_on: str, arms: Sequence[str]) -> list[str]:
    """Return what to do next, by the errors after the last trial: the best of the controls shown to be better, or more.

    Rows are those of `paired_comparison` with the largest number of experiments.
    """
    rows = compared[(compared["tested_on"] == tested_on) & (compared["measure"] == "final")]
    better = rows[rows["verdict"] == "control better"].sort_values("control_mean")
    undecided = [spell_arm(each) for each in rows.loc[rows["verdict"] == UNDECIDED, "control"]]
    told = []
    if len(better):
        best = str(better["control"].iloc[0])
        told.append(f"Choose by {spell_arm(best)}: python -m pipeline ARGUMENTS active_loop.utility={best}")
    elif undecided:
        told.append(
            f"More experiments show whether {spell_arm(arms[0])} or "
            f"{' or '.join(undecided) if len(undecided) < 3 else 'another choice'} is better: "
            "python -m pipeline ARGUMENTS subsampling.experiments=20"
        )
    told.append(
        "See on the simulator how the effect is found that a textbook lacks in such trials, and models that use it "
        "(some minutes; for trials of a real rig, see docs/naming.md): "
        "python -m pipeline experiment=naming"
    )
    return told


def _percent(rate: float) -> str:
    return f"{100 * rate:.2g} %" if rate < 0.1 else f"{100 * rate:.0f} %"
