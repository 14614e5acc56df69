"""The error rate that is to be expected on the task, trial after trial, in each experiment of an arm."""

import pandas as pd

from stages.science.figures.canvas import COLOURS, Figure, new_figure

OTHERS = "#9aa3ad"


def draw_expected_errors(trials: pd.DataFrame, limit: float | None) -> Figure:
    """Draw the median over trials, a line for each experiment, the first one's with its intervals.

    Trials have participant, experiment, trial, expected_error, expected_low and expected_high, as rates; a limit is
    drawn where there is one.
    """
    from matplotlib.ticker import MaxNLocator

    figure, ((axis,),) = new_figure(6.4, 3.6, grid="both")
    percent = trials.assign(**100.0 * trials[["expected_error", "expected_low", "expected_high"]])
    experiments = list(percent.groupby(["participant", "experiment"], sort=False))
    for position, (_, its) in enumerate(experiments[1:]):
        label = "other experiments" if not position else None
        axis.plot(its["trial"], its["expected_error"], color=OTHERS, linewidth=0.8, label=label)
    (participant, experiment), its = experiments[0]
    reach = abs(its[["expected_low", "expected_high"]].sub(its["expected_error"], axis=0)).to_numpy().T
    bars = {"markersize": 4, "capsize": 3, "label": f"{participant}, experiment {experiment}, 95 % interval"}
    axis.errorbar(its["trial"], its["expected_error"], reach, fmt="o-", color=COLOURS[0], **bars)
    if limit is not None:
        axis.axhline(100.0 * limit, color="#2b2b2b", linestyle="--", linewidth=1.0, label="ends below")
    axis.set(xlabel="trial", ylabel="error rate to be expected (%)", ylim=(0, None))
    axis.set_xlim(0.5, percent["trial"].max() + 0.5)
    axis.xaxis.set_major_locator(MaxNLocator(integer=True))
    axis.legend(frameon=False, fontsize=9)
    return figure
