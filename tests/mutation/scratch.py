"""A scratch clone with a fault in it, and what the tests there say, those nearest to the fault first."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from tests.mutation.mutants import Fault
from tests.near import list_tests, rank_tests


@dataclass(frozen=True)
class Step:
    """A part of CI: which tests it takes, how pytest hands them out, and the word that a file with any of them has."""

    name: str
    marker: str
    options: tuple[str, ...] = ()
    word: str = ""


IN_ORDER = ("-n", "2", "--dist", "loadfile", "--no-loadscope-reorder")
STEPS = (
    Step("near", "not slow and not realtime", IN_ORDER),
    Step("default", "not slow and not realtime", IN_ORDER),
    Step("slow", "slow and not realtime", ("-n", "2", "--dist", "worksteal"), "slow"),
    Step("realtime", "realtime", (), "realtime"),
)
"""As in README.md and .ci/run; of the README's line, the files nearest to a fault come before the others."""
NEAREST = 10
UNHARMED = "unharmed"
LONGEST_S = 3600.0
"""For a step without a fault; with one, as much as it took without, twice and a minute more."""
FAILED = re.compile(r"^(?:FAILED|ERROR) (.+?)(?: - .*)?$", re.MULTILINE)
PASSED, NO_TESTS = 0, 5


class Scratch:
    """A clone of a commit in a folder of its own, a fault committed on top, with empty caches."""

    def __init__(self, folder: Path, root: Path, commit: str, fault: Fault | None = None):
        self.folder, self.root = folder, folder / "project"
        for name in ("temporary", "cache"):
            (folder / name).mkdir(parents=True)
        _git(folder, "clone", "-q", "--shared", "--no-checkout", str(root), str(self.root))
        _git(self.root, "checkout", "-q", "--detach", commit)
        if fault is not None:
            path = self.root / fault.file
            path.write_bytes(fault.plant(path.read_bytes()))
            _git(self.root, "-c", "user.name=n", "-c", "user.email=n@localhost", "commit", "-q", "-a", "-m", "fault")

    def try_tests(self, step: Step, files: Sequence[str], limit_s: float, but: Sequence[str] = ()) -> str | None:
        """Return which test fails first, what else went wrong, or None where all pass."""
        chosen = [each for each in files if step.word in (self.root / each.partition("::")[0]).read_text()]
        if not chosen:
            return None
        line = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "--maxfail=1", "-rfE", "--tb=no"]
        line += ["-m", step.marker, *step.options, *(f"--deselect={each}" for each in but), *chosen]
        changes = {
            "PYTHONPATH": self.root,
            "TMPDIR": self.folder / "temporary",
            "XDG_CACHE_HOME": self.folder / "cache",
            "NUMBA_CACHE_DIR": self.folder / "cache" / "kernels",
            "MPLCONFIGDIR": self.folder.parent / "fonts",
        }
        environment = {**os.environ, **{name: str(path) for name, path in changes.items()}}
        with (self.folder / "printed.txt").open("w+") as printed:
            process = subprocess.Popen(line, cwd=self.root, env=environment, stdout=printed, stderr=printed)
            try:
                code = process.wait(limit_s)
            except subprocess.TimeoutExpired:
                return "time limit"
            finally:
                process.kill()
                process.wait()
                self.end()
            printed.seek(0)
            output = printed.read()
        if code in (PASSED, NO_TESTS):
            return None
        failed = FAILED.search(output)
        return failed[1] if failed else f"exit code {code}: {output.strip()[-200:]}"

    def end(self) -> None:
        """End every process that tests left behind: it has this folder in its environment."""
        mark = os.fsencode(self.folder) + b"/"
        for path in Path("/proc").glob("[0-9]*/environ"):
            try:
                if mark in path.read_bytes():
                    os.kill(int(path.parent.name), signal.SIGKILL)
            except OSError:
                pass  # another's, or gone


class Bench:
    """Plants faults in clones of the last commit; notes what came of each step in a file of JSON lines, once."""

    def __init__(self, root: Path, results: Path, folder: Path):
        self.root, self.results, self.folder = root, results, folder
        self.commit = _git(root, "rev-parse", "HEAD").strip()
        self.clean = Scratch(folder / "clean", root, self.commit)
        lines = [json.loads(line) for line in results.read_text().splitlines()] if results.exists() else []
        self.found = {(each["fault"], each["step"]): each for each in lines if each["commit"] == self.commit}
        self.noticed = {(each["fault"], (each["test"] or "").partition("::")[0]) for each in lines}

    def source(self, fault: Fault) -> bytes:
        return (self.clean.root / fault.file).read_bytes()

    def check(self, steps: Sequence[Step], faults: Iterable[Fault]) -> None:
        """Refuse to plant anything where a step fails without a fault; of the first step, as far as it serves them."""
        nearest = sorted(
            {file for each in faults for file in rank_tests(self.clean.root, each.file, each.within)[:NEAREST]}
        )
        for step in steps[1:] or steps:
            if step is STEPS[0] or (UNHARMED, step.name) not in self.found:
                begun = time.monotonic()
                files = nearest if step is STEPS[0] else list_tests(self.clean.root)
                self._note(UNHARMED, step.name, self.clean.try_tests(step, files, LONGEST_S), begun)
            test = self.found[UNHARMED, step.name]["test"]
            if test is not None:
                raise SystemExit(f"{step.name}: {test} fails without any fault")

    def examine(self, fault: Fault, steps: Sequence[Step]) -> None:
        """Plant a fault, and note what each step says, until one notices it."""
        name = fault.name(self.source(fault))
        known = [self.found.get((name, step.name)) for step in steps]
        if all(known) or any(each and each["test"] for each in known):
            return
        ranked = rank_tests(self.clean.root, fault.file, fault.within)
        ranked.sort(key=lambda file: (name, file) not in self.noticed)
        scratch = Scratch(Path(tempfile.mkdtemp(dir=self.folder)), self.root, self.commit, fault)
        try:
            for step in [step for step, each in zip(steps, known, strict=True) if each is None]:
                begun = time.monotonic()
                files = {"near": ranked[:NEAREST], "default": ranked[NEAREST:]}.get(step.name, ranked)
                test = self._try_soundly(scratch, step, files)
                self._note(name, step.name, test, begun)
                if test is not None:
                    return
        finally:
            scratch.end()
            shutil.rmtree(scratch.folder, ignore_errors=True)

    def _try_soundly(self, scratch: Scratch, step: Step, files: Sequence[str]) -> str | None:
        """Return the first test that fails with the fault, and passes without it."""
        unharmed = self.found.get((UNHARMED, "default" if step is STEPS[0] else step.name))
        limit_s = 60.0 + 2.0 * unharmed["seconds"] if unharmed else LONGEST_S
        unsound: list[str] = []
        while True:
            test = scratch.try_tests(step, files, limit_s, unsound)
            if test is None or "::" not in test:
                return test
            if self.clean.try_tests(Step("alone", step.marker), [test], LONGEST_S) != test:
                return test
            unsound.append(test)

    def _note(self, fault: str, step: str, test: str | None, begun: float) -> None:
        seconds = round(time.monotonic() - begun, 1)
        found = {"commit": self.commit, "fault": fault, "step": step, "test": test, "seconds": seconds}
        self.found[fault, step] = found
        self.results.parent.mkdir(parents=True, exist_ok=True)
        with self.results.open("a") as lines:
            lines.write(json.dumps(found) + "\n")
        print(f"{fault}: {step}, {seconds} s: {test or 'all pass'}", flush=True)


def _git(folder: Path, *arguments: str) -> str:
    return subprocess.run(["git", *arguments], cwd=folder, check=True, capture_output=True, text=True).stdout
