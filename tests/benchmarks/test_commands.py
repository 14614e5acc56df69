"""What a person waits for before anything is done, what a sweep adds to its jobs, and what jobs at once save."""

import shutil
import statistics
import subprocess
import sys
import time

import pytest

from tests.conftest import ROOT, Command

FEW = 4
BARE = """
import hydra

@hydra.main(version_base="1.3", config_path={conf!r}, config_name="config")
def application(config):
    pass

application()
"""


@pytest.fixture
def bare(tmp_path):
    """Return the command line of a bare Hydra application with the same configuration."""
    script = tmp_path / "bare.py"
    script.write_text(BARE.format(conf=str(ROOT / "conf")))
    return [sys.executable, str(script)]


def run(line):
    subprocess.run(line, cwd=ROOT, check=True, capture_output=True)


def test_help(bare, against, tell):
    ours = [sys.executable, "-m", "pipeline", "--help"]
    tell("--help / bare Hydra's", against(lambda: run(ours), lambda: run([*bare, "--help"]), 10, 2))


def test_run_where_all_is_fresh(bare, tmp_path, against, tell):
    command = Command(tmp_path / "outputs", "budget=tiny")
    first = command()
    assert first.returncode == 0, first.stderr
    assert "everything is fresh" in command().stdout
    quiet = [*bare, "hydra.run.dir=.", "hydra.output_subdir=null"]
    ratio = against(lambda: run(command.line()), lambda: run(quiet), 10, 2)
    tell("run where all is fresh / bare Hydra's", ratio, limit=2.5)


def sweep(folder, *arguments):
    """Return the seconds that a sweep takes."""
    command = Command(folder, "--config-dir", "tests/pipeline/conf", "-m", "sweep=s")
    begun = time.perf_counter()
    result = command(*arguments)
    assert result.returncode == 0, result.stderr
    return time.perf_counter() - begun


def test_a_job_beside_its_work(tmp_path, benchmark, sized, tell):
    """Of jobs of one quick stage, what each further one costs, above an empty Python."""
    costs, more = [], sized(24, 14)
    for each in range(sized(3, 1)):
        few, many = (
            sweep(tmp_path / f"{n}-{each}", "workflow=count", f"seed=range({n})", "hydra.launcher.n_jobs=1")
            for n in (FEW, more)
        )
        costs.append((many - few) / (more - FEW))
    benchmark.pedantic(lambda: subprocess.run([sys.executable, "-c", "pass"], cwd=ROOT, check=True), rounds=5)
    above_s = statistics.median(costs) - benchmark.stats.stats.median
    tell("job of a toy stage, above Python's start-up", 1e3 * above_s, "ms", limit=150.0)


def test_jobs_at_once(tmp_path, benchmark, sized, tell):
    arguments = ("workflow=trials", f"seed=range({sized(8, 4)})", f"trying.busy_s={sized(2.0, 1.0)}")
    serial = sweep(tmp_path / "serial", *arguments, "hydra.launcher.n_jobs=1")
    parallel = benchmark.pedantic(lambda: sweep(tmp_path / "parallel", *arguments, "hydra.launcher.n_jobs=2"), rounds=1)
    tell("two jobs at once / one after the other", parallel / serial)
    tables = [
        {
            path.parent.parent.name: path.read_bytes()
            for path in (tmp_path / how).glob("sweeps/s/*/tables/tried.parquet")
        }
        for how in ("serial", "parallel")
    ]
    assert tables[0] == tables[1]


def test_a_session_divided_among_workers(tmp_path, benchmark, sized, tell):
    """Of 16 trials of 4 muscles, by the clock, in turns; whatever is computed for the first time is computed before."""
    session = tmp_path / "session"
    run(
        [
            sys.executable,
            "-m",
            "stages.benchmark.blinded_rig",
            str(session),
            "effect=creep",
            "magnitude=medium",
            "seed=7",
        ]
    )
    taken: dict[int, list[float]] = {1: [], 2: []}

    def search(workers):
        command = Command(tmp_path / str(time.perf_counter_ns()), "workflow=discrepancy", f"measured={session}")
        begun = time.perf_counter()
        run(command.line(f"workers={workers}"))
        taken[workers].append(time.perf_counter() - begun)
        return command.runs[0]

    def take_turns():
        return [search(workers) for workers in taken]

    take_turns()
    for seconds in taken.values():
        seconds.clear()
    first, second = benchmark.pedantic(take_turns, rounds=sized(3, 1))
    for path in (first / "tables").iterdir():
        assert path.read_bytes() == (second / "tables" / path.name).read_bytes()
    alone, divided = map(statistics.median, taken.values())
    tell("session of 16 trials x 4 muscles on two workers", divided, "s")
    tell("session of 16 trials x 4 muscles, two workers / one", divided / alone)


def test_review_of_many_jobs(tmp_path, benchmark, sized, tell):
    """Of a sweep of many jobs, with its table and its page, and of all runs in a list."""
    jobs = sized(1000, 200)
    command = Command(tmp_path / "outputs", "--config-dir", "tests/pipeline/conf", "-m", "sweep=s")
    command.anew = True
    assert command("workflow=trials", "seed=0,1", "trying.fail_at=[1]").returncode == 1
    for first in [*(tmp_path / "outputs/sweeps/s").glob("[!.]*/")]:
        text = (first / "run.json").read_text()
        seed = next(each for each in first.name.split(",") if each.startswith("seed="))
        for number in range(int(seed[-1]) + 2, jobs, 2):
            name = first.name.replace(seed, f"seed={number}")
            shutil.copytree(first, first.parent / name)
            told = text.replace(first.name, name).replace(seed, f"seed={number}")
            (first.parent / name / "run.json").write_text(told)

    def review(*arguments):
        result = command.review(*arguments)
        assert result.returncode == 0, result.stderr
        return result.stdout

    assert f"{jobs} jobs ({jobs // 2} done, {jobs // 2} failed)" in review("sweep", "s")
    benchmark.pedantic(lambda: review("sweep", "s"), rounds=sized(3, 1))
    tell(f"review of a sweep of {jobs} jobs", benchmark.stats.stats.median, "s", limit=3.0)
    begun = time.perf_counter()
    assert f"first 40 of {jobs} rows" in review("list", "--jobs")
    tell(f"list of {jobs} jobs", time.perf_counter() - begun, "s", limit=3.0)
