"""``python -m tests.benchmarks.growth``: how the cost of an active iteration grows.

By candidates, samples of a muscle (N) and muscles, one of the three at a time: the others are 40,000 candidates,
N = 30, 4 muscles. Fit and scoring apart. With ``--sessions`` also the search of a discrepancy, by the trials of its
session: the whole workflow, in a process of its own. Each round takes processor seconds of a fixed piece of arithmetic
directly before. Exponents are slopes of logarithms, by least squares over all sizes and over the three largest.

    python -m tests.benchmarks.growth --compare FIRST.parquet SECOND.parquet      # which costs changed
"""

import sys
import tempfile
from collections.abc import Callable, Sequence
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import linregress
from threadpoolctl import threadpool_limits

from tests.benchmarks.problems import Problem
from tests.benchmarks.results import (
    count_rows,
    describe_run,
    keep_rows,
    read_arguments,
    read_rows,
    show,
    show_comparison,
    summarise,
)
from tests.benchmarks.turns import measure_command, peak_allocated_mb, take_turn, time_call

ROUNDS, SAMPLES = 3, 250
BASE = {"points": 30, "muscles": 4, "trajectories": 40, "samples": SAMPLES}
AXES = {
    "candidates": (10_000, 32_000, 100_000, 320_000, 1_000_000),
    "N": (10, 30, 60, 120, 250, 500),
    "muscles": (4, 8, 16, 32),
}
TRIALS = (10, 20, 50, 100, 200)
HIDDEN = ("effect=creep", "magnitude=medium", "seed=3")
TINY_AXES = {"candidates": (4000, 8000), "N": (6, 12), "muscles": (1, 2)}
LARGEST = 3
FIT, SCORING, TASK, SEARCH = "fit", "scoring by y_y", "scoring for a task", "search of a discrepancy"
MOST_MB = 64.0
"""Of what scoring holds beyond its result."""

Call = Callable[[], Any]


def build(axis: str, size: int) -> Problem:
    """Return the problem that has this many candidates in all, samples of a muscle, or muscles."""
    named = {"candidates": "trajectories", "N": "points"}.get(axis, axis)
    count = size // (SAMPLES * BASE["muscles"]) if axis == "candidates" else size
    return Problem(**BASE | {named: count})


def list_calls(problem: Problem, axis: str) -> dict[str, Call]:
    """Return what is measured of a problem, by name; its fit does not depend on candidates."""
    scored = {
        SCORING: lambda: problem.score(problem.renew_models()),
        TASK: lambda: problem.score_for_task(problem.renew_models()),
    }
    return scored if axis == "candidates" else {FIT: problem.fit_again, **scored}


def measure(
    kept: pd.DataFrame, path: Path, axes: dict[str, Sequence[int]], reference: Call, rounds: int
) -> pd.DataFrame:
    """Return the rows of all figures at all sizes, each kept as soon as it is there; rounds lie far apart."""
    told = describe_run(())
    asked = [(axis, size) for axis, sizes in axes.items() for size in sizes]
    for turn, (axis, size) in product(range(rounds), asked):
        for name, call in list_calls(build(axis, size), axis).items():
            key = {"figure": name, "axis": axis, "size": size}
            if count_rows(kept, **key) <= turn:
                kept = keep_rows(kept, [{**told, **key, **run(call, reference)}], path)
    return kept


def run(call: Call, reference: Call) -> dict[str, float]:
    """Return a round of a call, after one that tells its memory."""
    memory_mb = peak_allocated_mb(call)
    seconds, against_s = take_turn([(call, 1.0)], reference)
    return {"seconds": seconds, "against_s": against_s, "memory_mb": memory_mb}


def measure_sessions(kept: pd.DataFrame, path: Path, trials: Sequence[int], reference: Call) -> pd.DataFrame:
    """Return the rows with those of sessions of so many trials, a round each."""
    told = describe_run(())
    for size in trials:
        key = {"figure": SEARCH, "axis": "trials", "size": size}
        if not count_rows(kept, **key):
            kept = keep_rows(kept, [{**told, **key, **search(size, reference)}], path)
    return kept


def search(trials: int, reference: Call) -> dict[str, float]:
    """Return what the discrepancy workflow costs on a session of so many trials."""
    with tempfile.TemporaryDirectory() as folder:
        data, python = f"{folder}/data", [sys.executable, "-m"]
        measure_command([*python, "stages.benchmark.blinded_rig", data, *HIDDEN, f"trials={trials}"])
        against_s = time_call(reference)
        given = (f"measured={data}", f"outputs={folder}/runs", "figures=[]", "workers=1")
        cost = measure_command([*python, "pipeline", "workflow=discrepancy", *given])
    return {"seconds": cost.processor_s, "against_s": against_s, "memory_mb": cost.memory_mb}


def fit_exponents(rows: pd.DataFrame) -> pd.DataFrame:
    """Return the exponents of processor seconds by size, with standard errors, over all sizes and the largest."""
    found = []
    for (name, axis), medians in summarise(rows).sort_values("size").groupby(["figure", "axis"], sort=False):
        told = {"figure": name, "axis": axis, "from": medians["size"].min(), "to": medians["size"].max()}
        whole, largest = fit_exponent(medians), fit_exponent(medians.tail(LARGEST))
        found.append(told | whole | {f"{key}_of_largest": value for key, value in largest.items()})
    return pd.DataFrame(found)


def fit_exponent(medians: pd.DataFrame) -> dict[str, float]:
    """Return the slope of log seconds by log size, with its standard error; nan where there are too few sizes."""
    if len(medians) < 3:
        return {"exponent": np.nan, "error": np.nan}
    line = linregress(np.log(medians["size"]), np.log(medians["seconds"]))
    return {"exponent": line.slope, "error": line.stderr}


def tabulate(rows: pd.DataFrame) -> pd.DataFrame:
    """Return medians by axis, figure and size, with scoring that holds too much."""
    table = summarise(rows)[["axis", "figure", "size", "seconds", "ratio", "memory_mb", "rounds"]]
    beyond = table["figure"].isin([SCORING, TASK]) & (table["memory_mb"] > MOST_MB)
    table = table.assign(remark=beyond.map({True: f"MORE than {MOST_MB:g} MB", False: ""}))
    return table.sort_values(["axis", "figure", "size"], ignore_index=True)


def main() -> None:
    """Measure what is not there, and print the tables; or compare two files."""
    asked = read_arguments(
        __doc__, "growth", {"--sessions": "also searches by trials"}, f"one of {', '.join(AXES)} (all)"
    )
    if asked.compare:
        return show_comparison(asked.compare)
    axes, rounds = (TINY_AXES, 2) if asked.tiny else (AXES, ROUNDS)
    axes = {axis: sizes for axis, sizes in axes.items() if asked.only in axis}
    try:
        with threadpool_limits(1):
            reference = Problem(60, muscles=1).floor
            kept = measure(read_rows(asked.results), asked.results, axes, reference, rounds)
            if asked.sessions:
                measure_sessions(kept, asked.results, TRIALS[:1] if asked.tiny else TRIALS, reference)
    except KeyboardInterrupt:
        print(f"stopped; the same command goes on, and {asked.results} has what follows")
    rows = read_rows(asked.results)
    if len(rows):
        show(tabulate(rows))
        show(fit_exponents(rows))


if __name__ == "__main__":
    main()
