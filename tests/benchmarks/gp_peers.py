"""``python -m tests.benchmarks.gp_peers``: active iterations beside Gaussian processes of other libraries.

Four muscles of N = 30, 60, 120 samples and 160,000 candidates, a process and a thread. Each round takes processor
seconds of our work directly before a peer's; a ratio above 1 says that the peer takes longer. What takes too long is
computed in part and extrapolated, and marked so. Rows are kept as they come, in a file of this commit; what it has is
not run again.

    python -m tests.benchmarks.gp_peers --compare FIRST.parquet SECOND.parquet    # which ratios changed
"""

import importlib
from collections.abc import Sequence
from itertools import product
from pathlib import Path
from typing import Any

import pandas as pd
from threadpoolctl import threadpool_limits

from tests.benchmarks.gp_libraries import OWN, PEERS, Peer, Prepared, hold_to_one_thread, quiet
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
from tests.benchmarks.turns import add_parts, peak_resident_mb, take_turn

SIZES, ROUNDS = (30, 60, 120), 5
TINY = {"muscles": 2, "trajectories": 2, "samples": 100}
TOLD = ["own_memory_mb", "agreement", "compile_s", "extrapolated"]
PACKAGES = ("torch", "gpytorch", "botorch", "jax", "jaxlib", "numpyro", "GPy")


def is_installed(peer: Peer) -> bool:
    """Return whether everything that a peer needs can be imported, and import it."""
    try:
        with quiet():
            for name in peer.needs:
                importlib.import_module(name)
    except ImportError:
        return False
    return True


def measure(
    peers: Sequence[Peer], kept: pd.DataFrame, path: Path, sizes: Sequence[int], rounds: int, **problem: int
) -> pd.DataFrame:
    """Return the rows of all peers at all sizes, each kept in the file as soon as it is there.

    Rounds of a peer lie as far apart as the run is long, so that their spread holds what else the machine does.
    """
    told = describe_run(PACKAGES)
    for turn, size, peer in product(range(rounds), sizes, peers):
        wanted = 1 if peer.once else turn + 1
        if count_rows(kept, figure=peer.name, size=size) < wanted and is_installed(peer):
            row = run_peer(peer, Problem(size, **problem))
            kept = keep_rows(kept, [{**told, "figure": peer.name, "axis": "N", "size": size, **row}], path)
    return kept


def run_peer(peer: Peer, problem: Problem) -> dict[str, Any]:
    """Return a round of a peer, after one that is not timed and tells the memory.

    A peer that runs once is timed in its only run, without its memory.
    """
    own = OWN[peer.own](problem)
    own()
    prepared = peer.prepare(problem)
    memory = {"memory_mb": float("nan"), "own_memory_mb": peak_resident_mb(own)}
    if not peer.once:
        memory["memory_mb"] = peak_resident_mb(lambda: add_parts(prepared.parts))
    seconds, against_s = take_turn(prepared.parts, own)
    return {"own": peer.own, "seconds": seconds, "against_s": against_s, **memory, **describe(prepared)}


def describe(prepared: Prepared) -> dict[str, Any]:
    """Return what a row tells beside times: the agreement, seconds of compilation, and whether all was computed."""
    extrapolated = any(times != 1.0 for _, times in prepared.parts)
    return {"agreement": prepared.agree(), "compile_s": prepared.compile_s, "extrapolated": extrapolated}


def tabulate(rows: pd.DataFrame) -> pd.DataFrame:
    """Return medians by size and peer, with what disagrees where both compute the same."""
    limits = {peer.name: peer.limit for peer in PEERS}
    told = rows.drop_duplicates(["figure", "size"])[["figure", "size", *TOLD]]
    table = summarise(rows).merge(told).sort_values("size", kind="stable")
    beyond = table["agreement"] > table["figure"].map(limits)
    table = table.assign(remark=beyond.map({True: "DISAGREES", False: ""})).drop(columns="axis")
    return table.rename(columns={"size": "N", "against_s": "ours_s", "own_memory_mb": "ours_mb"})


def describe_peers() -> pd.DataFrame:
    """Return what each peer is beside, what either computes alone, what agreement is of, and what was extrapolated."""
    return pd.DataFrame(
        {
            "figure": peer.name,
            "beside our": peer.own,
            "computes also": peer.beyond,
            "lacks": peer.lacks,
            "agreement": peer.of,
            "extrapolated": peer.note,
            "here": "" if is_installed(peer) else f"not installed: pip install {' '.join(peer.needs)}",
        }
        for peer in PEERS
    )


def draw(rows: pd.DataFrame, path: Path) -> None:
    """Draw how many times our processor seconds each peer takes, by N; a hollow mark is extrapolated."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    table = tabulate(rows)
    names = list(table.groupby("figure")["ratio"].min().sort_values().index)
    figure, axes = plt.subplots(figsize=(7.2, 0.42 * len(names) + 1.3), layout="constrained")
    for place, (size, chosen) in enumerate(table.groupby("N")):
        at = [names.index(name) + 0.2 * (place - 1) for name in chosen["figure"]]
        colour = f"C{place}"
        faces = ["white" if each else colour for each in chosen["extrapolated"]]
        axes.scatter(chosen["ratio"], at, 34, faces, edgecolors=colour, zorder=3)
        axes.scatter([], [], 34, colour, label=f"N = {size}")
    axes.scatter([], [], 34, "white", edgecolors="0.3", label="extrapolated")
    axes.axvline(1.0, color="0.3", linewidth=1.0)
    axes.set(xscale="log", xlabel="processor time of the library / ours, same task", yticks=range(len(names)))
    axes.set_yticklabels(names)
    axes.xaxis.set_major_formatter("{x:,g}")
    axes.annotate("ours is faster →", (1.0, 0.0), (4, 4), axes.get_xaxis_transform(), "offset points", color="0.3")
    axes.set_ylim(len(names) - 0.5, -0.5)
    axes.grid(axis="x", color="0.9")
    axes.spines[["top", "right"]].set_visible(False)
    figure.legend(loc="outside upper right", ncols=4, frameon=False)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def main() -> None:
    """Measure what is not there, and print the tables; or compare two files."""
    asked = read_arguments(__doc__, "gp_peers", {}, "peers whose name has this, as JAX (all)")
    if asked.compare:
        return show_comparison(asked.compare)
    hold_to_one_thread()
    kept = read_rows(asked.results)
    sizes, rounds, problem = ((8,), 2, TINY) if asked.tiny else (SIZES, ROUNDS, {})
    try:
        with threadpool_limits(1):
            measure([peer for peer in PEERS if asked.only in peer.name], kept, asked.results, sizes, rounds, **problem)
    except KeyboardInterrupt:
        print(f"stopped; the same command goes on, and {asked.results} has what follows")
    rows = read_rows(asked.results)
    if len(rows):
        show(tabulate(rows))
        draw(rows, asked.results.with_suffix(".png"))
    show(describe_peers())


if __name__ == "__main__":
    main()
