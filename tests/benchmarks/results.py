"""Rows of measurements that are kept as they come, and the table, the figure and the comparison of two files of them.

A row is a round: `figure`, `axis` and `size` say what was measured, `seconds` and `against_s` are those of the subject
and of the baseline directly before it. Only their ratio is compared between files.
"""

import argparse
import json
import os
import platform
import subprocess
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import ttest_ind

from tests.conftest import ROOT

KEY = ["figure", "axis", "size"]
LEVEL = 0.99
LEAST = 0.05
"""Change of a ratio that is told: runs of one commit differ by less."""
OURS = ("numpy", "scipy", "scikit-learn")


def read_rows(path: Path) -> pd.DataFrame:
    """Return the rows that a file has; none where there is no file."""
    return pd.read_parquet(path) if path.exists() else pd.DataFrame()


def keep_rows(kept: pd.DataFrame, rows: Sequence[Mapping[str, Any]], path: Path) -> pd.DataFrame:
    """Return the kept rows with more, after both are in the file."""
    kept = pd.concat([kept, pd.DataFrame(rows)], ignore_index=True) if len(kept) else pd.DataFrame(rows)
    path.parent.mkdir(parents=True, exist_ok=True)
    kept.to_parquet(path.with_suffix(".part"))
    os.replace(path.with_suffix(".part"), path)
    return kept


def count_rows(kept: pd.DataFrame, **asked: Any) -> int:
    """Return how many rows have these values."""
    if kept.empty:
        return 0
    return int(np.logical_and.reduce([kept[name] == value for name, value in asked.items()]).sum())


@cache
def read_commit() -> str:
    """Return the short name of the commit, with ``-changed`` where files differ from it."""
    told = subprocess.run(
        ["git", "describe", "--always", "--dirty=-changed", "--exclude=*"], cwd=ROOT, capture_output=True, text=True
    )
    return told.stdout.strip() or "unknown"


def describe_run(packages: Iterable[str]) -> dict[str, str]:
    """Return the commit, the machine, and the versions of those packages that are installed."""
    found = {name: tell_version(name) for name in (*OURS, *packages)}
    versions = json.dumps({"python": platform.python_version(), **{k: v for k, v in found.items() if v}})
    return {"commit": read_commit(), "machine": read_machine(), "versions": versions}


def tell_version(package: str) -> str:
    """Return a package's version; empty where it is not installed."""
    try:
        return version(package)
    except PackageNotFoundError:
        return ""


def read_machine() -> str:
    """Return processor, cores and system."""
    told = Path("/proc/cpuinfo")
    names = [line.partition(": ")[2] for line in told.read_text().splitlines() if line.startswith("model name")]
    return f"{names[0] if names else platform.processor()}, {os.cpu_count()} cores, {platform.system()}"


def summarise(rows: pd.DataFrame) -> pd.DataFrame:
    """Return the medians of each figure's rounds, in the order of the rows."""
    groups = rows.assign(ratio=rows["seconds"] / rows["against_s"]).groupby(KEY, sort=False)
    medians = groups[["seconds", "against_s", "ratio", "memory_mb"]].median()
    return medians.assign(rounds=groups.size()).reset_index()


def compare(first: pd.DataFrame, second: pd.DataFrame) -> pd.DataFrame:
    """Return by what factor each ratio differs in the second file, with an interval of 99 % (Welch, of logarithms).

    `told` says whether it is a change: the interval holds no factor within 5 % of 1. One round alone tells none.
    """
    logs = [np.log(each["seconds"] / each["against_s"]).groupby([each[k] for k in KEY]) for each in (first, second)]
    before, after = (dict(list(each)) for each in logs)
    shared = [key for key in dict.fromkeys(first[KEY].itertuples(index=False, name=None)) if key in after]
    return pd.DataFrame([dict(zip(KEY, key, strict=True)) | compare_logs(before[key], after[key]) for key in shared])


def compare_logs(before: pd.Series, after: pd.Series) -> dict[str, Any]:
    """Return two figures' ratios, their factor with its interval, and what it tells."""
    low = high = np.nan
    if min(len(before), len(after)) > 1:
        low, high = np.exp(ttest_ind(after, before, equal_var=False).confidence_interval(LEVEL))
    told = "lower" if high < 1.0 / (1.0 + LEAST) else "higher" if low > 1.0 + LEAST else "no change told"
    factor = np.exp(after.mean() - before.mean())
    ratios = {"first": np.exp(before.mean()), "second": np.exp(after.mean())}
    return {**ratios, "factor": factor, "low": low, "high": high, "told": told}


def show(table: pd.DataFrame) -> None:
    """Print a table as a whole."""
    with pd.option_context("display.width", 200, "display.max_rows", None, "display.max_columns", None):
        print(table.to_string(index=False, float_format="{:.3g}".format, na_rep=""))


def read_arguments(about: str | None, name: str, flags: Mapping[str, str], only: str) -> argparse.Namespace:
    """Return the options: the results file, two files to compare, what alone is measured, flags with what they do."""
    parser = argparse.ArgumentParser(description=about, formatter_class=argparse.RawDescriptionHelpFormatter)
    results = Path("outputs") / f"{name}-{read_commit()}.parquet"
    parser.add_argument("--results", type=Path, default=results, help=f"kept results ({results})")
    parser.add_argument("--compare", type=Path, nargs=2, metavar=("FIRST", "SECOND"), help="two files of results")
    parser.add_argument("--tiny", action="store_true", help="the smallest size, two rounds: whether all runs")
    parser.add_argument("--only", default="", metavar="TEXT", help=only)
    for flag, told in flags.items():
        parser.add_argument(flag, action="store_true", help=told)
    return parser.parse_args()


def show_comparison(paths: Sequence[Path]) -> None:
    """Print what two files' ratios differ by."""
    first, second = (pd.read_parquet(each) for each in paths)
    show(compare(first, second))
    for each in (first, second):
        print(", ".join(each[["commit", "machine"]].iloc[-1]))
