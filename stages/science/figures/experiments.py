"""Experiments as points beside their mean: errors under other hyperpriors, and how far utilities fall short."""

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd

from stages.science.figures.canvas import COLOURS, Figure, new_figure
from stages.science.figures.learning_curves import TITLES

STYLES = {"table_1": ("#2b2b2b", "o"), "mean": ("#c1272d", "s"), "variance": ("#3b6fb6", "^")}
SPREAD = 0.24


def draw_sensitivity(errors: pd.DataFrame, labels: Mapping[tuple[str, float], str]) -> Figure:
    """Draw the error rate after the last trial, by setting.

    Columns are kind, setting, experiment, tested_on, before and after (error rates); labels name each kind, one of
    `STYLES`, and setting, in order.
    """
    panels = list(errors["tested_on"].unique())
    figure, (axes,) = new_figure(5.4 * len(panels) + 0.4, 4.2, 1, len(panels), "y", sharey=True)
    for axis, panel in zip(axes, panels, strict=True):
        for position, (kind, setting) in enumerate(labels):
            chosen = (errors["tested_on"] == panel) & (errors["kind"] == kind) & (errors["setting"] == setting)
            its = errors[chosen].sort_values("experiment")
            colour, marker = STYLES[kind]
            beside = position + SPREAD * np.linspace(-1, 1, len(its)) if len(its) > 1 else [position]
            axis.plot(beside, 100 * its["after"], marker, color=colour, markersize=4, alpha=0.55, linestyle="none")
            ends = [position - 0.36, position + 0.36]
            for name, line, width in (("after", "-", 2.2), ("before", ":", 1.6)):
                axis.plot(ends, [100 * its[name].mean()] * 2, linestyle=line, color=colour, linewidth=width)
        axis.set(title=TITLES.get(panel, panel))
        axis.set_xticks(range(len(labels)), list(labels.values()), fontsize=8.5)
        axis.set_ylim(bottom=0)
        axis.tick_params(labelleft=True)
    axes[0].set_ylabel("error rate, average of the muscles (%)")
    axes[0].plot([], [], "o", color="#2b2b2b", markersize=4, label="an experiment after its last trial")
    axes[0].plot([], [], color="#2b2b2b", linewidth=2.2, label="their mean")
    axes[0].plot([], [], ":", color="#2b2b2b", linewidth=1.6, label="their mean before any trial")
    figure.legend(loc="outside lower center", ncols=3, frameon=False, fontsize=9)
    return figure


def draw_agreement(agreement: pd.DataFrame, utilities: Sequence[str], targets: Sequence[str]) -> Figure:
    """Draw each experiment's regret, averaged over trials, and the mean over experiments with its 95 % interval.

    Columns are participant, experiment, target, utility and regret; utilities and targets are values in their order.
    """
    from scipy.stats import t

    figure, (panels,) = new_figure(10.6, 3.6, 1, len(targets), "y", sharey=True)
    for axis, target in zip(panels, targets, strict=True):
        its = agreement[agreement["target"] == target]
        for position, utility in enumerate(utilities):
            rows = its[its["utility"] == utility]
            regret = 100 * rows.groupby(["participant", "experiment"])["regret"].mean().to_numpy()
            spread = np.linspace(-0.18, 0.18, regret.size) if regret.size > 1 else np.zeros(1)
            axis.plot(position + spread, regret, "o", color="#9aa5b1", markersize=4, zorder=2)
            half = t.ppf(0.975, regret.size - 1) * regret.std(ddof=1) / np.sqrt(regret.size) if regret.size > 1 else 0
            colour = COLOURS[0] if position == 0 else COLOURS[1]
            axis.errorbar(position, regret.mean(), half, fmt="_", color=colour, markersize=18, capsize=4, zorder=3)
        axis.set_xticks(range(len(utilities)), utilities, rotation=30, ha="right")
        axis.set_title(f"samples {target}")
    panels[0].set_ylabel("information forgone (%)")
    panels[0].set_ylim(bottom=0)
    return figure
