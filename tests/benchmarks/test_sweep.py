"""What a sweep adds to its jobs, and what jobs at once save."""

import subprocess
import sys
import time

from tests.conftest import ROOT, Command

FEW, MANY = 4, 24
JOBS, BUSY_S = 8, 2.0


def sweep(folder, *arguments):
    """Return the seconds that a sweep takes."""
    command = Command(folder, "--config-dir", "tests/pipeline/conf", "-m", "sweep=s")
    begun = time.perf_counter()
    result = command(*arguments)
    assert result.returncode == 0, result.stderr
    return time.perf_counter() - begun


def test_a_job_beside_its_work(tmp_path, benchmark, tell):
    """Of jobs of one quick stage, what each further one costs, above an empty Python."""
    few, many = (
        sweep(tmp_path / str(n), "workflow=count", f"seed=range({n})", "hydra.launcher.n_jobs=1") for n in (FEW, MANY)
    )
    benchmark.pedantic(lambda: subprocess.run([sys.executable, "-c", "pass"], cwd=ROOT, check=True), rounds=5)
    above_s = (many - few) / (MANY - FEW) - benchmark.stats.stats.median
    tell("job of a toy stage, above Python's start-up", 1e3 * above_s, "ms", limit=150.0)


def test_jobs_at_once(tmp_path, benchmark, tell):
    arguments = ("workflow=trials", f"seed=range({JOBS})", f"trying.busy_s={BUSY_S}")
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
