"""``python -m tests.benchmarks.residual_peers``: named effects beside plain models of the residual, on equal sessions.

Sessions of the rig that hides an effect flow in: 16 trials, of which the workflow fits 10, then 6 of the same kind and
the same 6 with larger pressures and motion, which nothing is fitted to. Out flows a Parquet of the gap that each method
leaves of both, and a table. Sessions that the file has are not run again.
"""

import argparse
import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from scipy.stats import wilcoxon

from stages.benchmark.blinded_rig.chain import Carried, fine_time
from stages.benchmark.blinded_rig.dataset import PAUSE_S, describe, size_effects, tabulate
from stages.benchmark.blinded_rig.effects import ALL_EFFECTS, EFFECTS, OUTSIDERS_FOR_BUILDING
from stages.benchmark.blinded_rig.scenarios import MAGNITUDES, Scenario, scenario
from stages.benchmark.blinded_rig.session import Session, observe, prescribe, sampled
from stages.benchmark.blinded_rig.sessions import DRAWN
from stages.benchmark.blinded_rig.surroundings import SEED_OFFSET, CatalogueName
from stages.science.discrepancy.muscle_dataset import build_muscle_channels
from stages.science.discrepancy.parts import FITTED
from stages.science.discrepancy.restoring import SearchTables, read_maps
from stages.science.output_channels.features import evaluate_map
from stages.science.output_channels.muscle_channels import MuscleChannel
from stages.science.recording.datasets import tabulate_session
from stages.science.signals.trajectories import Array
from tests.benchmarks.residual_models import PEERS, build_features
from tests.benchmarks.results import count_rows, keep_rows, read_rows
from tests.measured_data import write_dataset
from tests.science.discrepancy.searches import DISCREPANCY

TRIALS, FURTHER = 16, 6
PRESSURES, MOTION = 1.25, 1.2
"""Factors of the commands and of the motion about its middle, in trials that extrapolate."""
FIRST_SEED, SESSIONS = 300, 24
NAMED, OUTSIDE, NONE = GROUPS = ("a name is true", "no name is true", "nothing is missing")
TURN = (NAMED, OUTSIDE, NAMED, NONE, NAMED, OUTSIDE)
OUTSIDERS = tuple(key for key, effect in EFFECTS.items() if effect.outsider)
PARTS = OPENED, EXTRAPOLATED = "opened", "extrapolated"
METHODS = ("nominal", "named", "patched", *PEERS)
STAGES = "stages=[measurement,locate_gap,name_effect,explain_remainder]"
SEARCHED = ("channels", "decision", "named_effects", "suspected_effects", "unexplained", "steps")
WORSE = 1.05
"""Gap over the nominal plant's from which on a method counts as worse."""


@dataclass(frozen=True)
class Hidden:
    """What a session hides, and the group that it belongs to."""

    group: str
    hidden: Scenario


class Recorded(NamedTuple):
    """Rows of all trials as measured and without noise, and what ``meta.json`` holds."""

    measured: pd.DataFrame
    quiet: pd.DataFrame
    meta: dict[str, Any]


class Amended(NamedTuple):
    """What the workflow made of the fitted trials: its tables, names of effects, fitted trials, and seconds."""

    found: SearchTables
    maps: dict[tuple[str, str], Any]
    names: list[str]
    fitted: list[int]
    seconds: float


def list_sessions(count: int) -> list[Hidden]:
    """Return the first sessions of an endless list, groups in turn, a seed each; medium and strong effects in turn."""
    sessions, met = [], dict.fromkeys(GROUPS, 0)
    for index in range(count):
        group = TURN[index % len(TURN)]
        keys, catalogue = choose_effect(group, met[group])
        size = MAGNITUDES[1 + (met[group] + met[group] // len(DRAWN)) % 2]
        seed = FIRST_SEED + index + index // len(TURN)  # the load cell's site follows its parity
        asked = scenario(keys, size, seed, catalogue=catalogue)
        sessions.append(Hidden(group, replace(asked, trials=TRIALS + FURTHER)))
        met[group] += 1
    return sessions


def choose_effect(group: str, place: int) -> tuple[tuple[str, ...], CatalogueName]:
    """Return the effect hidden in a group's session, and whose machine; outsiders on both machines in turn."""
    if group == NONE:
        return (), "own"
    if group == NAMED:
        return (DRAWN[place % len(DRAWN)],), "own"
    keys = OUTSIDERS_FOR_BUILDING[::-1] if place % 2 else OUTSIDERS
    return (keys[place // 2 % len(keys)],), "foreign_building" if place % 2 else "own"


def record(hidden: Scenario) -> Recorded:
    """Return a session's trials, further ones, and these again with larger pressures and motion."""
    fit, _, carried = size_effects(hidden)
    session = fit.session
    parts = [observe_twice(session, carried, 0), observe_twice(enlarge(session, hidden), carried, hidden.trials)]
    meta = describe(session)
    start_s = session.stimulus.start_s
    meta["trial_start_s"] = [*start_s, *(start_s[-1] + PAUSE_S * np.arange(1, FURTHER + 1))]
    measured, quiet = (pd.concat(each, ignore_index=True) for each in zip(*parts, strict=True))
    return Recorded(measured, quiet, {**meta, "trials": len(meta["trial_start_s"])})


def enlarge(session: Session, hidden: Scenario) -> Session:
    """Return the machine in its last trials again, with larger pressures and motion."""
    stimulus, step_s = session.stimulus, 1.0 / session.rate_hz
    time_s = fine_time(stimulus.command_kpa.shape[-1], stimulus.oversampled)
    joint_rad = sampled(stimulus.joint_rad, time_s, stimulus.oversampled)
    middle = joint_rad.mean(axis=(1, 2), keepdims=True)
    larger = middle + MOTION * (joint_rad[:, -FURTHER:] - middle)
    seed = hidden.seed + SEED_OFFSET[hidden.catalogue]
    return prescribe(session, seed, PRESSURES * stimulus.command_kpa[:, -FURTHER:], larger, step_s, PAUSE_S)


def observe_twice(session: Session, carried: Carried, first: int) -> list[pd.DataFrame]:
    """Return the rows of a session as measured, and without noise; `first` is the number of its first trial."""
    silent = replace(session.stimulus, ripple_kpa=None)
    rows = []
    for each in (session, replace(session, stimulus=silent, noise=session.noise.silenced())):
        readings = observe(each, carried)
        told = tabulate(each.as_read(readings), readings)
        rows.append(told.assign(trial=told["trial"] + first))
    return rows


def amend(recorded: Recorded, folder: Path) -> Amended:
    """Run the workflow on the first trials, as it is, up to names and learned maps."""
    first = recorded.measured[recorded.measured["trial"] < TRIALS]
    meta = {**recorded.meta, "trials": TRIALS, "trial_start_s": recorded.meta["trial_start_s"][:TRIALS]}
    measured = write_dataset(folder / "data", first, meta)
    given = [
        "workflow=discrepancy",
        f"measured={measured}",
        f"outputs={folder}/runs",
        "figures=[]",
        "workers=1",
        STAGES,
    ]
    begun = perf_counter()
    subprocess.run([sys.executable, "-m", "pipeline", *given], check=True, capture_output=True)
    seconds = perf_counter() - begun
    (tables,) = (folder / "runs").glob("runs/*/tables")
    read = {path.stem: pd.read_parquet(path) for path in tables.glob("*.parquet")}
    found = SearchTables(**{name: read[name] for name in SEARCHED})
    fitted = np.flatnonzero(read["trial_parts"]["part"] == FITTED).tolist()
    names = list(dict.fromkeys(found.named_effects["name"]))
    return Amended(found, read_maps(read["learned_maps"]), names, fitted, seconds)


def simulate(output: MuscleChannel, amended: Amended, step: int, mapped: bool = False) -> Array:
    """Return a channel, (T, K), as the plant simulates it after so many additions, and with its map."""
    model, values = amended.found.restore(output, step)
    constants, effects = model.name_values(values)
    simulated = model.output.simulate(constants, effects)
    learned = amended.maps.get((output.channel, output.element)) if mapped else None
    return simulated if learned is None else simulated + evaluate_map(learned, model.output.told_by(constants))


def correct(output: MuscleChannel, nominal: Array, fitted: Sequence[int], peer: str) -> Array:
    """Return a channel's nominal simulation, (T, K), with a model of what it leaves of the fitted trials."""
    features = build_features(output, nominal)
    trials = np.broadcast_to(np.arange(output.trials), nominal.shape).ravel()
    rows = np.flatnonzero(output.present.ravel() & np.isin(trials, fitted))
    residual = (output.measured - nominal).ravel()[rows]
    rule = PEERS[peer](features.take(rows), residual, trials[rows])
    return nominal + rule(features).reshape(nominal.shape)


def build_outputs(rows: pd.DataFrame, meta: dict[str, Any]) -> list[MuscleChannel]:
    """Return the channels of a session's rows."""
    return build_muscle_channels(tabulate_session(rows, meta, ""), DISCREPANCY)


def pool_gap(outputs: Sequence[MuscleChannel], left: Sequence[Array], fitted: Sequence[int], trials: range) -> float:
    """Return the root mean square of what is left of some trials, over each channel's range in the fitted ones."""
    squares = [
        np.mean(each[:, trials] ** 2) / output.take(fitted).range ** 2
        for output, each in zip(outputs, left, strict=True)
    ]
    return float(np.sqrt(np.mean(squares)))


def run_session(session: Hidden, folder: Path) -> list[dict[str, Any]]:
    """Return a session's rows: a method and a part each."""
    recorded = record(session.hidden)
    amended = amend(recorded, folder)
    outputs = build_outputs(recorded.measured, recorded.meta)
    quiet = build_outputs(recorded.quiet, recorded.meta)
    nominal = [simulate(each, amended, 0) for each in outputs]
    simulated, seconds = {"nominal": nominal}, {"nominal": np.nan}
    last = amended.found.last_step
    for name in ("named", "patched"):
        simulated[name] = [simulate(each, amended, last, name == "patched") for each in outputs]
        seconds[name] = amended.seconds
    for peer in PEERS:
        begun = perf_counter()
        pairs = zip(outputs, nominal, strict=True)
        simulated[peer] = [correct(output, own, amended.fitted, peer) for output, own in pairs]
        seconds[peer] = perf_counter() - begun
    left = {name: [o.measured - s for o, s in zip(outputs, each, strict=True)] for name, each in simulated.items()}
    silent = [each.measured - simulate(each, amended, 0) for each in quiet]
    noise = [noisy - own for noisy, own in zip(left["nominal"], silent, strict=True)]
    told = {**describe_session(session), "found": ",".join(amended.names), "status": amended.found.status}
    return [
        {**told, "method": name, "seconds": seconds[name], **row}
        for name in METHODS
        for row in measure(outputs, left["nominal"], left[name], noise, amended.fitted)
    ]


def describe_session(session: Hidden) -> dict[str, str]:
    """Return a session's name, group, and the library's name of what it hides."""
    names = [str(ALL_EFFECTS[key].name) for key in session.hidden.effects]
    return {"session": session.hidden.name, "group": session.group, "true": ",".join(names)}


def measure(
    outputs: Sequence[MuscleChannel],
    nominal: Sequence[Array],
    left: Sequence[Array],
    noise: Sequence[Array],
    fitted: Sequence[int],
) -> Iterator[dict[str, Any]]:
    """Yield the gap of each part, what noise makes of it, and the share of the squared gap above it that is closed."""
    for part, first in ((OPENED, TRIALS), (EXTRAPOLATED, TRIALS + FURTHER)):
        trials = range(first, first + FURTHER)
        before, gap, floor = (pool_gap(outputs, each, fitted, trials) for each in (nominal, left, noise))
        closed = (before**2 - gap**2) / max(before**2 - floor**2, 1e-12)
        yield {"part": part, "gap": gap, "gap_nominal": before, "noise": floor, "closed": closed}


def run_sessions(count: int, path: Path) -> pd.DataFrame:
    """Return the rows of so many sessions, each kept in the file as soon as it is there."""
    kept = read_rows(path)
    for session in list_sessions(count):
        if count_rows(kept, session=session.hidden.name):
            continue
        with tempfile.TemporaryDirectory() as folder:
            rows = run_session(session, Path(folder))
        kept = keep_rows(kept, rows, path)
        print(json.dumps(summarise_session(pd.DataFrame(rows))), flush=True)
    return kept[kept["session"].isin([each.hidden.name for each in list_sessions(count)])]


def summarise_session(rows: pd.DataFrame) -> dict[str, Any]:
    """Return what is printed of a session: what was found, and gaps in per cent by part and method."""
    gaps = rows.set_index(["part", "method"])["gap"].mul(100.0).round(3)
    by_part = {part: {"noise": round(100.0 * noise, 3), **gaps[part]} for part, noise in list_noise(rows)}
    return {"session": rows["session"].iloc[0], "found": rows["found"].iloc[0], **by_part}


def list_noise(rows: pd.DataFrame) -> list[tuple[str, float]]:
    """Return each part's noise."""
    return [(part, float(rows.loc[rows["part"] == part, "noise"].iloc[0])) for part in PARTS]


def tabulate_methods(rows: pd.DataFrame) -> pd.DataFrame:
    """Return medians by group, part and method, and how many sessions are worse than the nominal plant."""
    marked = rows.assign(
        method=pd.Categorical(rows["method"], METHODS),
        group=pd.Categorical(rows["group"], GROUPS),
        part=pd.Categorical(rows["part"], PARTS),
        gap_percent=100.0 * rows["gap"],
        noise_percent=100.0 * rows["noise"],
        worse=rows["gap"] > WORSE * rows["gap_nominal"],
    )
    groups = marked.groupby(["group", "part", "method"], observed=True)
    medians = groups[["gap_percent", "noise_percent", "closed", "seconds"]].median()
    return medians.assign(worse=groups["worse"].sum(), sessions=groups.size())


def compare_named(rows: pd.DataFrame) -> pd.DataFrame:
    """Return the paired comparison of named effects with each peer where a name is true, in extrapolation.

    `sessions` says whether all are compared, or those alone in which the workflow found the true name.
    """
    chosen = rows[(rows["group"] == NAMED) & (rows["part"] == EXTRAPOLATED)]
    right = [true in found.split(",") for true, found in zip(chosen["true"], chosen["found"], strict=True)]
    compared = {"all": chosen, "named right": chosen[right]}
    return pd.DataFrame([compare(which, own, peer) for which, own in compared.items() for peer in ("patched", *PEERS)])


def compare(which: str, rows: pd.DataFrame, peer: str) -> dict[str, Any]:
    """Return the paired comparison of named effects with one method: wins, median ratio of gaps, Wilcoxon's p."""
    gaps = rows.pivot(index="session", columns="method", values="gap")
    ratio = np.log(gaps["named"] / gaps[peer]).to_numpy()
    p_value = float(wilcoxon(ratio).pvalue) if np.count_nonzero(ratio) else 1.0
    told = {"sessions": which, "count": len(ratio), "against": peer, "wins": int((ratio < 0.0).sum())}
    return {**told, "median_ratio": float(np.exp(np.median(ratio))) if len(ratio) else np.nan, "p_value": p_value}


def main() -> None:
    """Run the sessions that are not there, and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sessions", type=int, default=SESSIONS, help="number of sessions")
    parser.add_argument("--results", type=Path, default=Path("outputs/residual_peers.parquet"), help="kept results")
    asked = parser.parse_args()
    rows = run_sessions(asked.sessions, asked.results)
    with pd.option_context("display.width", 160, "display.max_rows", None, "display.max_columns", None):
        print(tabulate_methods(rows).round(3))
        print(compare_named(rows).round(4).to_string(index=False))


if __name__ == "__main__":
    main()
