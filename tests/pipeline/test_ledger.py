"""What a run's folder tells of the code it ran with, in checkouts that are really changed."""

import hashlib
import shutil
import subprocess

import pytest

from pipeline import checkout
from pipeline.checkout import LARGEST_PATCH
from tests.conftest import ROOT
from tests.faults import ledger_of, limit_file_size, overwrite
from tests.pipeline.conftest import ALONE, Toy, success, the_only_line

COUNTING = "tests/pipeline/toy/counting.py"


class Checkout(Toy):
    """The command beside a checkout."""

    def __init__(self, folder):
        super().__init__(folder / "outputs")
        self.place = folder / "project"
        (self.place / COUNTING).parent.mkdir(parents=True)
        (self.place / ".gitignore").write_text("__pycache__/\n")
        shutil.copy(ROOT / COUNTING, self.place / COUNTING)

    def git(self, *arguments):
        line = ["git", "-c", "user.name=n", "-c", "user.email=n@localhost", *arguments]
        return subprocess.run(line, cwd=self.place, check=True, capture_output=True).stdout

    def commit(self):
        self.git("init", "-q")
        self.git("add", "-A")
        self.git("commit", "-q", "-m", "all")
        return self

    def change(self, text="# changed\n"):
        with (self.place / COUNTING).open("a") as handle:
            handle.write(text)


@pytest.fixture
def copied(tmp_path, monkeypatch):
    """A clean checkout that the code is taken to lie in."""
    made = Checkout(tmp_path).commit()
    look = checkout.look_at_checkout.__wrapped__
    monkeypatch.setattr(checkout, "look_at_checkout", lambda: look(made.place))
    return made


def test_a_run_tells_the_commit_that_its_code_is_of(tmp_path):
    """With the whole project in the checkout, started in full."""
    copied = Checkout(tmp_path)
    for each in ("pipeline", "conf", "tests/pipeline"):
        ignored = shutil.ignore_patterns("__pycache__")
        shutil.copytree(ROOT / each, copied.place / each, ignore=ignored, dirs_exist_ok=True)
    (copied.place / "tests" / "__init__.py").touch()
    copied.commit()
    copied.root, copied.anew = copied.place, True
    success(copied, "counting.count=2")
    (run,) = copied.runs
    facts = ledger_of(run)
    assert facts["git"] == {"commit": copied.git("rev-parse", "HEAD").decode().strip(), "clean": True}
    assert facts["directory"] == str(copied.root)
    assert not (run / "changes.patch").exists()


def test_a_run_whose_changes_find_no_room_is_found_again(copied):
    copied.change(f"# {'x' * 300_000}\n")
    line = the_only_line(copied(before=limit_file_size(200_000)), 1)
    assert f"cannot write to {copied.runs[0]}" in line
    again = success(copied)
    (run,) = copied.runs
    assert f"resuming {run}" in again
    assert (run / "changes.patch").stat().st_size > 300_000


def test_changes_lie_beside_the_tables_and_can_be_had_again(copied, tmp_path):
    copied.change("LABEL = 'grün'\n")
    (copied.place / "picture.png").write_bytes(bytes(range(256)))
    copied.git("add", "picture.png")
    (copied.place / "new folder").mkdir()
    for name in ("note\n.txt", "other.txt"):
        (copied.place / "new folder" / name).touch()
    copied.git("config", "diff.noprefix", "true")
    copied.git("config", "diff.external", "false")
    assert copied().returncode == 0
    (run,) = copied.runs
    git = ledger_of(run)["git"]
    patch = run / "changes.patch"
    assert git["clean"] is False
    assert git["changes"] == {
        "file": "changes.patch",
        "sha256": hashlib.sha256(patch.read_bytes()).hexdigest(),
        "bytes": patch.stat().st_size,
        "complete": True,
        "untracked": 2,
    }
    assert "Untracked: 'new folder/note\\n.txt'\nUntracked: new folder/other.txt\n" in patch.read_text()
    again = tmp_path / "again"
    copied.git("clone", "-q", copied.place, again)
    copied.git("-C", again, "checkout", "-q", git["commit"])
    copied.git("-C", again, "apply", patch)
    for name in (COUNTING, "picture.png"):
        assert (again / name).read_bytes() == (copied.place / name).read_bytes()


def test_a_large_change_is_cut_off_and_said(copied):
    (copied.place / "large.bin").write_bytes(bytes(1) + b"x" * LARGEST_PATCH)
    lines = "".join(f"# {number}\n" for number in range(LARGEST_PATCH // 5))
    (copied.place / "zebra.py").write_text(lines)
    copied.git("add", "large.bin", "zebra.py")
    copied.change()
    assert copied().returncode == 0
    (run,) = copied.runs
    assert ledger_of(run)["git"]["changes"]["complete"] is False
    patch = (run / "changes.patch").read_text()
    assert len(patch) <= LARGEST_PATCH + 1000
    assert "Not all of them" in patch
    assert "+# changed" in patch
    assert "zebra" not in patch


def test_a_run_that_goes_on_with_other_code_says_both(copied):
    copied("doubling.fail_at=3")
    copied.change()
    assert "resuming" in copied("doubling.fail_at=3").stdout
    (run,) = copied.runs
    facts = ledger_of(run)
    assert facts["git"]["clean"] is True
    (later,) = facts["git_when_continued"]
    assert later["changes"]["file"] == "changes-2.patch"
    assert "+# changed" in (run / "changes-2.patch").read_text()


def test_jobs_of_a_sweep_have_theirs_and_none_of_before_when_made_again_from_a_clean_checkout(copied):
    copied.change()
    sweep = (*ALONE, "sweep=s", "seed=0,-1")
    assert copied(*sweep).returncode == 1
    jobs = [copied.outputs / "sweeps" / "s" / f"seed={seed},workflow=toy" for seed in (0, -1)]
    for job in jobs:
        assert ledger_of(job)["git"]["changes"]["file"] == "changes.patch"
        assert "+# changed" in (job / "changes.patch").read_text()
    copied.change("# and more\n")
    copied.git("commit", "-q", "-a", "-m", "more")
    overwrite(jobs[0] / "tables" / "total.parquet", b"")  # so that something is to be made again
    assert copied(*sweep, "on_finished=refresh").returncode == 1
    assert ledger_of(jobs[0])["git"]["clean"] is True
    assert not (jobs[0] / "changes.patch").exists()


@pytest.mark.parametrize("state", ["no checkout", "no commit", "no git"])
def test_without_a_commit_there_is_nothing_to_tell(copied, state, tmp_path):
    copied.environment["GIT_CEILING_DIRECTORIES"] = str(tmp_path)
    if state == "no git":
        copied.change()
        copied.environment["PATH"] = str(tmp_path)
    else:
        shutil.rmtree(copied.place / ".git")
    if state == "no commit":
        copied.git("init", "-q")
    result = copied()
    assert (result.returncode, result.stderr) == (0, "")
    assert ledger_of(copied.runs[0])["git"] is None
