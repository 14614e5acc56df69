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
from functools import cache
from pathlib import Path

import grimp

from tests.mutation.mutants import AREAS, Fault


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
FAR = 6
"""Steps of imports from which on they tell nothing."""
TYPED = 2
"""As many steps is the runner away from a test that types the command of the toy workflow."""
UNHARMED = "unharmed"
LONGEST_S = 3600.0
"""For a step without a fault; with one, as much as it took without, twice and a minute more."""
LATER = re.compile(r"^pytestmark = .*(slow|realtime)", re.MULTILINE)
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
        nearest = sorted({file for each in faults for file in rank_tests(self.clean.root, each)[:NEAREST]})
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
        ranked = sorted(rank_tests(self.clean.root, fault), key=lambda file: (name, file) not in self.noticed)
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


def list_tests(root: Path) -> list[str]:
    """Return all test files, from the project's folder."""
    found = (each.relative_to(root).as_posix() for each in (root / "tests").rglob("test_*.py"))
    return sorted(each for each in found if not each.startswith("tests/benchmarks/"))


def rank_tests(root: Path, fault: Fault) -> list[str]:
    """Return all test files, those nearest to a fault first; those last that hold nothing of the README's line.

    A test is as near as what it imports, or as what it is named for, by steps of imports.
    """
    module = _name_module(fault.file).removesuffix(".__init__")
    folder = f"tests/{Path(AREAS[fault.area]).name}/"
    words = _words(fault.file.removeprefix(AREAS[fault.area]))
    within = {each for each in fault.within.split(".") if len(each) > 3}

    def near(file: str) -> tuple[bool, int, int]:
        text, stem = (root / file).read_text(), Path(file).stem.removeprefix("test_")
        named_for = [each for each in _imports().modules if each.endswith(f".{stem}") and each != module]
        score = min([_count_steps(_name_module(file), module), *(_count_steps(each, module) for each in named_for)])
        score = min(score, TYPED) if fault.area == "runner" and "toy" in text else score
        score -= file.startswith(folder) + 2 * bool(words & _words(stem)) + any(each in text for each in within)
        return bool(LATER.search(text)), score, len(text)

    return sorted(list_tests(root), key=near)


def _name_module(file: str) -> str:
    return file.removesuffix(".py").replace("/", ".")


@cache
def _count_steps(importer: str, imported: str) -> int:
    chain = _imports().find_shortest_chain(importer, imported)
    return min(len(chain) - 1, FAR) if chain else FAR


def _words(name: str) -> set[str]:
    """Return how the words of a path begin, by which ``runner`` and ``test_runs`` are akin."""
    return {each[:3] for each in re.findall("[a-z]+", name)} - {"py", "ini", "sta"}


@cache
def _imports() -> grimp.ImportGraph:
    return grimp.build_graph("tests", "pipeline", "stages", cache_dir=None)


def _git(folder: Path, *arguments: str) -> str:
    return subprocess.run(["git", *arguments], cwd=folder, check=True, capture_output=True, text=True).stdout
