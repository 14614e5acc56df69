"""``python -m tests.benchmarks.simulated_bench_sessions FOLDER``: how often the workflow is right on simulated benches.

Every session is a record of an element whose law is a little wrong, run by the command that users type: 20 of each
machine without an effect, and 14 with one, each at three rates. A session that is done already is not repeated.
"""

import json
import shutil
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd

from tests.conftest import ROOT
from tests.science.discrepancy.simulated_benches import BENCHES, record_bench

RATES_HZ, SIZES = (20, 100, 400), (0.04, 0.06, 0.08)
EMPTY, PLANTED, FIRST_EMPTY, FIRST_PLANTED = 20, 14, 300, 400
KEYS = {
    "muscle": {"length": "contraction"},
    "cylinder": {"pressure": "p1_kpa", "second_pressure": "p2_kpa", "along": "position_m"},
    "damper": {"along": "position_m", "drive": "current_a", "speed": "speed_m_per_s"},
    "finger": {"along": "p1_kpa", "against": "p2_kpa"},
}
EFFECTS = {
    "muscle": ("hysteresis", "creep", "coulomb_friction"),
    "cylinder": ("coulomb_friction", "load_dependent_friction", "hysteresis"),
    "damper": ("lagged", "coulomb_friction", "hysteresis"),
    "finger": ("creep", "hysteresis", "coulomb_friction"),
}
NAMED = {"lagged": "load_dependent_friction"}
CLOSED = 0.8
"""Least share of the closable gap that an effect is to close."""


class Session(NamedTuple):
    """What is simulated."""

    machine: str
    effect: str
    size: float
    seed: int
    rate_hz: int

    @property
    def name(self) -> str:
        """Return its name, as that of its files."""
        return f"{self.machine}-{self.effect}-{self.seed}-{self.rate_hz}"


def list_sessions() -> Iterator[Session]:
    """Yield all sessions."""
    for machine, effects in EFFECTS.items():
        for k in range(EMPTY):
            yield Session(machine, "none", 0.0, FIRST_EMPTY + k, RATES_HZ[k % 3])
        for k in range(PLANTED):
            for rate_hz in RATES_HZ:
                yield Session(machine, effects[k % 3], SIZES[k // 3 % 3], FIRST_PLANTED + k, rate_hz)


def run(session: Session, folder: Path) -> dict[str, object]:
    """Return the session's verdict."""
    kept, table, outputs = (folder / f"{session.name}{end}" for end in (".json", ".csv", ""))
    if kept.exists():
        return dict(json.loads(kept.read_text()))
    signals = record_bench(session.machine, session.effect, session.size, session.seed, session.rate_hz)
    times = np.arange(len(next(iter(signals.values())))) / session.rate_hz
    pd.DataFrame({"t": times, **signals}).to_csv(table, index=False)
    plant = {"output": BENCHES[session.machine][1], **KEYS[session.machine]}
    given = [f"measured={table.resolve()}", "columns.time_s=t", *(f"+columns.{each}={each}" for each in signals)]
    given += [f"plant={session.machine}", *(f"plant.{key}={each}" for key, each in plant.items())]
    options = ["figures=[]", "workers=1", f"outputs={outputs.resolve()}"]
    command = ["-m", "pipeline", "workflow=discrepancy", "measurement=records", *given, *options]
    subprocess.run([sys.executable, *command], cwd=ROOT, check=True, stdout=subprocess.DEVNULL)
    (verdict,) = outputs.rglob("verdict.json")
    shutil.move(verdict, kept)
    shutil.rmtree(outputs)
    table.unlink()
    return dict(json.loads(kept.read_text()))


def count(verdicts: dict[Session, dict[str, object]]) -> pd.DataFrame:
    """Return a row for each machine."""
    rows = []
    for machine in EFFECTS:
        own = {session: each for session, each in verdicts.items() if session.machine == machine}
        named = {session: [effect["name"] for effect in each["effects"]] for session, each in own.items()}
        planted = [session for session in own if session.effect != "none"]
        right = [named[each][:1] == [NAMED.get(each.effect, each.effect)] for each in planted]
        told = Counter((each.seed, tuple(named[each]), own[each]["status"]) for each in planted)
        gaps = [own[each]["gap"] for each in planted]
        closed = [(gap["before"] - gap["after"]) / (gap["before"] - gap["noise_floor"]) for gap in gaps]
        rows.append(
            {
                "machine": machine,
                "empty": len(own) - len(planted),
                "empty, named": sum(bool(named[each]) for each in own if each.effect == "none"),
                "planted": len(planted),
                "named first": sum(right),
                "alike at all rates": sum(each == len(RATES_HZ) for each in told.values()),
                "closed, median": float(np.median(closed)),
                f"closed {CLOSED:.0%}": sum(each >= CLOSED for each in closed),
            }
        )
    return pd.DataFrame(rows)


def main(folder: Path) -> None:
    """Run what is not done yet, two sessions at a time, and print the table."""
    folder.mkdir(parents=True, exist_ok=True)
    sessions = list(list_sessions())
    with ThreadPoolExecutor(2) as threads:
        verdicts = dict(zip(sessions, threads.map(lambda each: run(each, folder), sessions), strict=True))
    print(count(verdicts).to_string(index=False))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
