"""``python -m tests.mutation``: plant faults one at a time, and tell which part of CI notices each."""

import argparse
import re
import signal
import sys
import tempfile
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path

import yaml

from tests.mutation.mutants import AREAS, Fault, draw
from tests.mutation.scratch import STEPS, Bench

HERE = Path(__file__).parent
ROOT = HERE.parent.parent
SEED = 20261123
"""Fixed before any test was written for what it draws; 20261124 draws those that no test is written for."""
MOST_EQUIVALENTS = 4


def draw_all(root: Path, seed: int, count: int, equivalent: Iterable[str]) -> list[Fault]:
    """Return as many faults of each area, those passed over that no test could notice."""
    drawn = [
        (each for each in draw(root, seed, area) if each.name((root / each.file).read_bytes()) not in set(equivalent))
        for area in AREAS
    ]
    return [next(drawn[k % len(drawn)]) for k in range(count)]


def read_safeguards(root: Path) -> list[Fault]:
    """Return the faults that each take a safeguard out.

    Raises
    ------
    ValueError
        Where what is to be taken out is not there exactly once.
    """
    faults = []
    for title, each in yaml.safe_load((HERE / "safeguards.yaml").read_text()).items():
        source, old = (root / each["file"]).read_bytes(), each["old"].encode()
        if source.count(old) != 1:
            raise ValueError(f"{title}: expected once in {each['file']}, got {source.count(old)} times")
        area = "rig" if each["file"].startswith(AREAS["rig"]) else "runner"
        start = source.index(old)
        edit = "safeguard", start, start + len(old), each["new"].encode()
        within = (re.findall(rb"def (\w+)", source[:start]) or [b""])[-1].decode()
        faults.append(Fault(area, each["file"], *edit, within, title))
    return faults


def tell(bench: Bench, faults: Sequence[Fault], steps: Sequence[str]) -> None:
    """Print a table of what noticed each fault, and how many were noticed by what."""
    rows = []
    for fault in faults:
        source = bench.source(fault)
        name = fault.name(source)
        found = [bench.found[name, step] for step in steps if (name, step) in bench.found]
        last = found[-1] if found else {"step": "", "test": None}
        by = last["step"] if last["test"] else "survived" if last["step"] == steps[-1] else "open"
        rows.append((fault.area, "default" if by == "near" else by))
        seconds = sum(each["seconds"] for each in found)
        place = f"{fault.area:<11}  {fault.kind:<9}  {fault.place(source):<42}"
        print(f"{name:<22}  {place}  {rows[-1][1]:<8}  {seconds:6.0f} s  {last['test'] or ''}")
    for area in ["all", *dict.fromkeys(area for area, _ in rows)]:
        its = Counter(by for where, by in rows if area in ("all", where))
        planted, early = its.total(), its["default"]
        late = planted - its["survived"] - its["open"]
        shares = f"{early} ({early / planted:.0%}) noticed by the default line, {late} ({late / planted:.0%}) by CI"
        print(f"{area:<11}  {planted} planted: {shares}, {its['survived']} survived, {its['open']} open")


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(prog="python -m tests.mutation", description=__doc__)
    parser.add_argument("--seed", type=int, default=SEED, help="by which faults are drawn")
    parser.add_argument("--count", type=int, default=40, help="how many are drawn, of each area as many")
    parser.add_argument("--safeguards", action="store_true", help="take out safeguards instead of drawing faults")
    parser.add_argument("--list", action="store_true", help="print what would be planted, and plant nothing")
    parser.add_argument("--tell", action="store_true", help="print what is known by now, and plant nothing")
    parser.add_argument("--only", nargs="+", metavar="NAME", help="plant these of them")
    parser.add_argument("--until", choices=[each.name for each in STEPS], default=STEPS[-1].name, help="last step")
    given = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda number, frame: sys.exit(128 + number))  # so that nothing is left behind
    equivalents = yaml.safe_load((HERE / "equivalents.yaml").read_text()) or {}
    if len(equivalents) > MOST_EQUIVALENTS:
        parser.error(f"equivalents.yaml: expected at most {MOST_EQUIVALENTS}, got {len(equivalents)}")
    steps = STEPS[: [each.name for each in STEPS].index(given.until) + 1]
    results = ROOT / "outputs" / "mutation" / f"{'safeguards' if given.safeguards else given.seed}.jsonl"
    with tempfile.TemporaryDirectory(prefix="mutation-", ignore_cleanup_errors=True) as folder:
        bench = Bench(ROOT, results, Path(folder))
        root = bench.clean.root
        faults = read_safeguards(root) if given.safeguards else draw_all(root, given.seed, given.count, equivalents)
        chosen = [each for each in faults if not given.only or each.name(bench.source(each)) in given.only]
        if given.list:
            for each in chosen:
                source = bench.source(each)
                print(f"{each.name(source)}  {each.area}  {each.kind}\n{each.diff(source)}")
            return
        if not given.tell:
            bench.check(steps, chosen)
            for each in chosen:
                bench.examine(each, steps)
        tell(bench, chosen, [each.name for each in steps])


if __name__ == "__main__":
    main()
