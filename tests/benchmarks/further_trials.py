"""``python -m tests.benchmarks.further_trials FOLDER``: do proposed trials tell names apart, better than random ones?

Short sessions with a weak effect, of the rig that hides one, are searched by the command that users type. Where that is
ambiguous, three further trials are proposed, or drawn, in two other runs. A run that is done already is not repeated.
"""

import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.stats import binomtest, wilcoxon

from stages.science.discrepancy.proposal import choose_round
from tests.conftest import ROOT

SEEDS, WANTED = range(7001, 7101), 40
"""Sessions that are looked at, in this order, and how many ambiguous ones are compared."""
SESSION = ["experiment=hidden_effect", "rig.magnitude=weak", "rig.trials=5", "figures=[]", "workers=1"]
TRIALS, SURE, ALIKE = 3, 0.9, 10.0
"""Further trials; the probability that they are to raise the true name above; and the ratio of two ambiguous names'."""


def run(folder: Path, seed: int, trials: int, choice: str) -> dict[str, pd.DataFrame]:
    """Return tables of a run, which is made unless it is there."""
    place = folder / f"{seed}-{choice}-{trials}"
    if not list(place.glob("runs/*/report.html")):
        keys = [*SESSION, f"seed={seed}", f"next_trials={trials}", f"propose_trial.choice={choice}", f"outputs={place}"]
        subprocess.run([sys.executable, "-m", "pipeline", *keys], cwd=ROOT, check=True, capture_output=True)
    (done,) = place.glob("runs/*/report.html")
    names = ("ranking", "named_effects", "suspected_effects", "comparison_with_truth")
    return {name: pd.read_parquet(done.parent / "tables" / f"{name}.parquet") for name in names}


def find_truth(tables: dict[str, pd.DataFrame]) -> str:
    """Return the name of what was hidden; empty where nothing was."""
    return next((name for name in tables["comparison_with_truth"]["hidden"] if name), "")


def is_ambiguous(tables: dict[str, pd.DataFrame]) -> bool:
    """Return whether the true name is one of the two leading ones of what is least sure, and these are alike."""
    told = (tables[each] for each in ("ranking", "named_effects", "suspected_effects"))
    question = choose_round(*told, most=3, least=0.01)
    if question is None:
        return False
    first, second = list(question.rivals.items())[:2]
    return find_truth(tables) in (first[0], second[0]) and max(first[1], second[1]) <= ALIKE * min(first[1], second[1])


def tell_probability(tables: dict[str, pd.DataFrame]) -> float:
    """Return the probability that is stated of the true name; zero where it is neither named nor suspected."""
    said = pd.concat([tables["named_effects"], tables["suspected_effects"]])
    return max(said.loc[said["name"] == find_truth(tables), "probability"].astype(float), default=0.0)


def compare(folder: Path) -> pd.DataFrame:
    """Return a row for each ambiguous session: what was hidden, and its probability before and after, by choice."""

    rows: list[dict[str, object]] = []

    def look(seed: int) -> dict[str, object] | None:
        if len(rows) >= WANTED:
            return None
        first = run(folder, seed, 0, "evidence")
        if not is_ambiguous(first):
            return None
        after = {each: tell_probability(run(folder, seed, TRIALS, each)) for each in ("evidence", "random")}
        return {"seed": seed, "hidden": find_truth(first), "before": tell_probability(first), **after}

    with ThreadPoolExecutor(2) as pool:
        for seed, row in zip(SEEDS, pool.map(look, SEEDS), strict=True):
            print(seed, row or "not ambiguous", flush=True)
            rows += [row] if row and len(rows) < WANTED else []
    return pd.DataFrame(rows)


def describe(found: pd.DataFrame) -> str:
    """Return the comparison in words, with an exact test of pairs above `SURE` and Wilcoxon's of probabilities."""
    sure = {each: found[each] > SURE for each in ("before", "evidence", "random")}
    alone = int((sure["evidence"] & ~sure["random"]).sum()), int((sure["random"] & ~sure["evidence"]).sum())
    p_sure = binomtest(alone[0], sum(alone)).pvalue if sum(alone) else 1.0
    more = found["evidence"] - found["random"]
    p_value = wilcoxon(more).pvalue if (more != 0.0).any() else 1.0
    effect = more.mean() / more.std(ddof=1)
    low, high = np.quantile(np.random.default_rng(0).choice(more, (10000, len(more))).mean(axis=1), [0.025, 0.975])
    above = ", ".join(f"{each} {its.mean():.0%}" for each, its in sure.items())
    means = ", ".join(f"{each} {found[each].mean():.2f}" for each in sure)
    return (
        f"{len(found)} ambiguous sessions. True name above {SURE:g}: {above} ({alone[0]} to {alone[1]}, "
        f"p = {p_sure:.2g}). Its mean probability: {means}; paired difference {more.mean():.2f} ({low:.2f} to "
        f"{high:.2f}), {effect:.2f} standard deviations, Wilcoxon p = {p_value:.2g}."
    )


if __name__ == "__main__":
    given = Path(sys.argv[1]).resolve()
    table = compare(given)
    table.to_parquet(given / "further_trials.parquet")
    print(table.to_string(index=False))
    print(describe(table))
