"""What a sweep shows: which keys vary, what metrics do over them, which jobs failed, and what all have alike."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import pandas as pd

from pipeline.command import command_line
from pipeline.errors import ConfigError, suggest
from pipeline.flat import is_seed
from pipeline.printing import SHOWN, format_p, format_value, show_percent
from pipeline.review.curves import find_interval, half_width
from pipeline.review.selection import order_of
from pipeline.runs import list_folders, list_ledgers, sweeps_folder
from pipeline.sweeps.sweep_table import collect_sweep

AS_CONFIGURED = "not set"


@dataclass(frozen=True)
class Sweep:
    """A sweep to look at: its folder, and what `collect_sweep` returns of it."""

    folder: Path
    frame: pd.DataFrame
    described: dict[str, dict[str, str]]

    @cached_property
    def units(self) -> dict[str, str]:
        """Units in which columns are to be read that have one."""
        return {name: each.get(SHOWN) or each["unit"] for name, each in self.described.items()}

    @cached_property
    def unfinished(self) -> dict[str, str]:
        """Statuses of jobs that are not done."""
        left = self.frame[self.frame["status"] != "done"]
        return dict(zip(left["job"], left["status"], strict=True))

    @property
    def failed(self) -> dict[str, str]:
        """Statuses of jobs that something happened to."""
        return {job: status for job, status in self.unfinished.items() if status not in ("not begun", "running")}

    @property
    def counts(self) -> dict[str, int]:
        """Jobs by status."""
        return {str(status): int(count) for status, count in self.frame["status"].value_counts().items()}

    @property
    def keys(self) -> list[str]:
        """What jobs override."""
        return [*self.frame.loc[:, :"status"].columns[1:-1]]

    @property
    def metrics(self) -> list[str]:
        """What jobs measured, by name."""
        return [*self.frame.loc[:, "status":"wall_s"].columns[1:-1]]

    @cached_property
    def varying(self) -> dict[str, list[str]]:
        """Values of each key that varies, in order."""
        values = {key: sorted({*self.texts(key)}, key=order_of) for key in self.keys}
        return {key: found for key, found in values.items() if len(found) > 1}

    def texts(self, key: str) -> pd.Series:
        """Return what each job overrides a key with, as text."""
        return self.frame[key].where(self.frame[key].notna(), AS_CONFIGURED).astype(str)

    @property
    def axes(self) -> list[str]:
        """Keys that vary and are no seed: over them, metrics are looked at."""
        return [each for each in self.varying if not is_seed(each)]

    @property
    def seeds(self) -> list[str]:
        """Keys that vary and only repeat."""
        return [each for each in self.varying if is_seed(each)]

    @property
    def alike(self) -> dict[str, str]:
        """What all jobs have the same, by column."""
        first = self.frame.iloc[0]
        return {
            name: format_value(first[name])
            for name in [*self.keys, "commit"]
            if name not in self.varying and not _differs(self.frame[name]) and not pd.isna(first[name])
        }

    def table(self, everything: bool) -> pd.DataFrame:
        """Return a row for each job, as it is to be read: the columns that vary and those that measure, or all."""
        frame = show_percent(self.frame, self.units)
        if everything:
            return frame
        telling = [*self.varying, "status", *self.metrics, "wall_s", "peak_memory_mb"]
        if _differs(self.frame["commit"]):
            telling.append("commit")
        if not self.varying or self.frame.duplicated(list(self.varying)).any():
            telling.insert(0, "job")
        return frame[[each for each in telling if not frame[each].isna().all()]]

    def title(self, metric: str) -> str:
        """Return what a metric is called in words."""
        return self.described.get(metric, {}).get("title", metric)

    def floor(self, metric: str) -> float:
        """Return the least value that a metric can have, as it is to be read, or minus infinity."""
        return float(self.described.get(metric, {}).get("low", -np.inf))

    def points(self, metric: str) -> pd.DataFrame:
        """Return the jobs that have a metric as a number: it as it is to be read as ``value``, each axis as text."""
        shown = show_percent(self.frame[[metric]], self.units)[metric]
        value = pd.to_numeric(shown, errors="coerce").astype(float)
        found = pd.DataFrame({**{key: self.texts(key) for key in self.varying}, "value": value})
        return found[np.isfinite(value) & (self.frame["status"] == "done")].reset_index(drop=True)


def describe_extremes(sweep: Sweep) -> list[str]:
    """Return in a sentence for each metric, the last first, with which values of a key it is least and most.

    The key is the first that varies and is no seed. An analysis of variance tells whether that may be chance: of seeds,
    which alone repeat by chance; jobs of the same seed that differ in another key are one value, their mean.
    """
    sentences = []
    for metric in reversed(sweep.metrics) if sweep.axes else []:
        key, unit = sweep.axes[0], f" {sweep.units.get(metric, '1')}".removesuffix(" 1")
        points = sweep.points(metric).groupby([key, *sweep.seeds])["value"].mean().reset_index()
        found = points.groupby(key)["value"].agg(["mean", "std", "count"])
        if len(found) < 2 or found["mean"].nunique() < 2:
            continue
        doubt = f"{'so few seeds tell' if sweep.seeds else 'no seed varies, which tells'} nothing of chance"
        if found["count"].min() > 1:
            p, test = compare_values(points, key)
            doubt = f"{'' if p < 0.05 else 'not '}told apart ({format_p(p)}, {test})"
            if np.isnan(p):
                doubt = "seeds do not change the difference, which tells nothing of chance"
        found["half"] = half_width(found["std"], found["count"])
        told = []
        for value, row in found.loc[[found["mean"].idxmin(), found["mean"].idxmax()]].iterrows():
            low, high = find_interval(row["mean"], row["half"], sweep.floor(metric))
            band = "" if np.isnan(row["half"]) else f" ({low:.3g} to {high:.3g})"
            told.append(f"with {key}={value}, {row['mean']:.3g}{band}{unit}")
        sentences.append(f"{sweep.title(metric)} is least {told[0]}, and most {told[1]}: {doubt}.")
    if sentences:
        seeds = ", in brackets the mean's 95 % interval (t) over seeds" if sweep.seeds else ""
        sentences.append(f"Means over jobs{seeds}.")
    return sentences


def compare_values(points: pd.DataFrame, key: str) -> tuple[float, str]:
    """Return the p-value of no difference between values of a key, and the name of the analysis of variance.

    Where each value has one job for every choice of the other keys, as of seeds, jobs of one choice are a block. It is
    nan where repeats differ by rounding alone, so that there is no chance to tell a difference from.
    """
    from scipy.stats import f, f_oneway

    rounding = 1e-9 * points["value"].abs().max()
    others = [each for each in points.columns if each not in (key, "value")]
    if others and not points.duplicated([key, *others]).any():
        crossed = points.set_index([*others, key])["value"].unstack().to_numpy()
        blocks, values = crossed.shape
        if blocks > 1 and np.isfinite(crossed).all():
            left = crossed - crossed.mean(axis=0) - crossed.mean(axis=1, keepdims=True) + crossed.mean()
            between = blocks * crossed.mean(axis=0).var() * values / (values - 1)
            freedom = (values - 1) * (blocks - 1)
            within = (left**2).sum() / freedom
            p = f.sf(between / within, values - 1, freedom) if np.abs(left).max() > rounding else np.nan
            return float(p), f"analysis of variance within the same {' and '.join(others)}"
    grouped = [values.to_numpy() for _, values in points.groupby(key)["value"]]
    alike = max(map(np.ptp, grouped)) <= rounding
    return np.nan if alike else float(f_oneway(*grouped).pvalue), "one-way analysis of variance"


def propose_seeds(sweep: Sweep, arguments: Sequence[str]) -> str:
    """Return a sentence with the command that adds as many seeds again, from the arguments of the last launch."""
    told = (
        "Further seeds tell more; fix beforehand how many, as p is too small where seeds are added until it is small:"
    )
    key = next(iter(sweep.seeds), "seed")
    known = sweep.varying.get(key, [])
    count = 2 * len(known) or 8
    typed = list(arguments)
    if {*known} <= {str(each) for each in range(count)}:
        typed = [*(each for each in arguments if each.partition("=")[0] != key), f"{key}=range({count})"]
    return f"{told} {command_line(typed)}"


def find_sweep(outputs: str | Path, name: str) -> Sweep:
    """Return the sweep of a name in the outputs folder, or at a path; ``latest`` is the one that ran last.

    It raises `ConfigError` where there is none, or it has no job.
    """
    place = sweeps_folder(outputs)
    if name == "latest":
        jobs = [each.folder.parent for each in list_ledgers(outputs) if each.folder.parent.parent == place]
        name = jobs[0].name if jobs else name
    folder = next((each for each in (place / name, Path(name)) if name and each.is_dir()), None)
    if folder is None or folder == place:
        names = sorted({each.parent.name for each in list_folders(outputs) if each.parent.parent == place})
        told = suggest(name, [*names, "latest"]) if names else f"make one with: {command_line(['-m', 'seed=0,1'])}"
        raise ConfigError(f"no sweep '{name}' in {place}, nor a folder of this name; {told}")
    frame, described = collect_sweep(folder)
    if {*frame["status"]} <= {"no ledger"}:
        raise ConfigError(f"{folder} is no sweep: expected a folder with a folder for each job, each with a run.json")
    return Sweep(folder, frame, described)


def _differs(values: pd.Series) -> bool:
    return len(set(values.fillna("").astype(str))) > 1
