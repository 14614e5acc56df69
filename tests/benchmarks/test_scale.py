"""What many jobs cost those who look at them, plan more, or begin a run beside: seconds and memory, by their number."""

import json
import os
import shutil

import pytest

from tests.benchmarks.turns import measure_command
from tests.conftest import Command

MOST_S, MOST_MB = 20.0, 500.0
"""For the list and the sweep's page, at 10,000 jobs."""
SHARED = ("config.yaml", "log.txt", "report.html")


def multiply(job, jobs):
    """Make a job of a sweep into so many, whose ledgers differ as those of so many seeds do; tables are not made."""
    text = (job / "run.json").read_text()
    launch = next((job.parent / ".launches").glob("*/launch.json"))
    planned = json.loads(launch.read_text())
    (first,) = planned["jobs"]
    for seed in range(1, jobs):
        name = job.name.replace("seed=0", f"seed={seed}")
        made = job.with_name(name)
        made.mkdir()
        for each in SHARED:
            os.link(job / each, made / each)
        facts = json.loads(text.replace(job.name, name))
        facts.update(sequence=facts["sequence"] + seed, identity=f"{seed:064x}")
        for metric in facts["metrics"].values():
            metric["value"] *= 1 + seed / jobs
        for place, record in enumerate(facts["stages"].values()):
            if "seed" in record["config"]:
                record["config"]["seed"] = seed
                record["fingerprint"] = f"{place:032x}{seed:032x}"
            for file in (*record["tables"].values(), *record["files"].values()):
                file["sha256"] = f"{seed:032x}{file['sha256'][:32]}"
        (made / "run.json").write_text(json.dumps(facts, indent=1))
        overrides = [each.replace("seed=0", f"seed={seed}") for each in first["overrides"]]
        planned["jobs"].append({"job": name, "overrides": overrides})
    launch.write_text(json.dumps(planned))


@pytest.fixture(scope="module")
def one_job(tmp_path_factory):
    """The command with a sweep of one job."""
    command = Command(tmp_path_factory.mktemp("scale") / "outputs", "budget=tiny", "figures=[]")
    command.anew = True
    result = command("-m", "sweep=s", "seed=0")
    assert result.returncode == 0, result.stderr
    return command


@pytest.mark.parametrize("jobs", [100, *(pytest.param(each, marks=pytest.mark.long) for each in (1000, 10_000))])
def test_many_jobs(one_job, tmp_path, jobs, benchmark, tell):
    command = one_job.copy(tmp_path / "outputs")
    (job,) = (command.outputs / "sweeps/s").glob("[!.]*/")
    multiply(job, jobs)
    lines = {
        "list": command.review_line("list"),
        "list of jobs": command.review_line("list", "--jobs", "--where", "seed=5"),
        "page of the sweep": command.review_line("sweep", "s"),
        "comparison of two": command.review_line("compare", *(f"s/budget=tiny,seed={seed}" for seed in (0, 1))),
        "plan of as many more": command.line("-m", "sweep=t", f"seed=range({jobs},{2 * jobs})", "plan=true"),
        "plan of a run": command.line("seed=0", "active_loop.trials=2", "plan=true"),
        "a run": command.line("seed=0", "active_loop.trials=2"),
    }
    figures = {name: measure_command(line) for name, line in lines.items()}
    benchmark.pedantic(lambda: measure_command(lines["list"]), rounds=1)
    for name, (seconds, memory_mb, _) in figures.items():
        bound = jobs == 10_000 and name in ("list", "page of the sweep")
        tell(f"{name}, {jobs} jobs", seconds, "s", limit=MOST_S if bound else None)
        tell(f"{name}, {jobs} jobs, memory", memory_mb, "MB", limit=MOST_MB if bound else None)
    shutil.rmtree(command.outputs)
