"""Review of many runs by real commands: lists, sweeps, comparisons, reports of failures, on outputs of every kind."""

import json
import re
import shutil

import pandas as pd
import pytest

from pipeline.files import TEMPORARY_SUFFIX
from tests.conftest import Command
from tests.faults import ledger_of
from tests.pipeline.conftest import ALONE, CONFIG

TRIALS = (*CONFIG, "workflow=trials")
SWEEP = (*ALONE, "sweep=s", "seed=0,1,2", "counting.count=3,4", "trying.fail_at=[1]")


@pytest.fixture(scope="session")
def swept(make_once):
    """Outputs with two runs and a sweep of six jobs of which two failed; not to be changed."""

    def run(folder):
        command = Command(folder / "outputs", *TRIALS)
        assert command(*SWEEP).returncode == 1
        assert command("seed=5").returncode == 0
        assert command("seed=6", "counting.label=other").returncode == 0

    return Command(make_once("swept", run) / "outputs", *TRIALS)


@pytest.fixture
def copied(swept, tmp_path):
    """The same outputs elsewhere, to be spoilt; what another worker is writing there just now is left out."""
    return swept.copy(tmp_path / "copy", ignore=shutil.ignore_patterns(f".*{TEMPORARY_SUFFIX}*"))


def job(command, *parts, sweep="s"):
    """Return the folder of the job whose name has all these parts."""
    folders = (command.outputs / "sweeps" / sweep).glob("[!.]*/")
    (found,) = (each for each in folders if all(part in each.name.split(",") for part in parts))
    return found


def change(folder, **facts):
    """Change facts of a run's ledger."""
    path = folder / "run.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), **facts}))


def test_list_has_a_line_for_a_sweep_or_for_each_of_its_jobs(swept):
    lines = swept.review("list").stdout.splitlines()
    assert sum(" s/ " in line for line in lines) == 1
    assert "4 of 6 jobs, 2 failed" in "\n".join(lines)
    assert "s/counting" not in "\n".join(lines)
    jobs = swept.review("list", "--jobs").stdout
    assert jobs.count("s/counting.count=") == 6
    assert " s/ " not in jobs
    assert "first 2 of 8 rows; --rows 8 shows all" in swept.review("list", "--jobs", "--rows", "2").stdout


def test_list_counts_jobs_that_did_not_begin(copied):
    shutil.rmtree(job(copied, "seed=2", "counting.count=3"))
    assert "3 of 6 jobs, 2 failed, 1 not begun" in copied.review("list").stdout


def test_the_outputs_folder_is_named_before_or_after_and_in_what_is_printed(swept):
    elsewhere = Command(swept.outputs.parent / "nowhere")
    assert "no runs in" in elsewhere.review("list").stdout
    listed = swept.review("list").stdout
    assert elsewhere.review("list", "--outputs", str(swept.outputs)).stdout == listed
    place = f"-m pipeline.review --outputs {swept.outputs} "
    assert f"{place}sweep NAME" in listed
    assert f"{place}show " in swept.review("show", "latest").stdout


def test_list_is_sorted_and_chosen_from_by_columns_metrics_and_configuration(swept):
    shown = swept.review("list", "--jobs", "--sort", "-score_m", "--where", "status=done").stdout
    scores = [float(each) for each in re.findall(r"stages +(\d+\.\d+)", shown)]
    assert len(scores) == 6
    assert scores == sorted(scores, reverse=True)
    some = swept.review("list", "--jobs", "--where", "counting.count=3", "--where", "seed<2", "--sort", "seed").stdout
    assert some.count("s/counting.count=3") == 2
    assert "counting.count=4" not in some
    assert swept.review("list", "--jobs", "--where", "run~SEED=1").stdout.count("s/counting") == 2
    assert swept.review("list", "--jobs", "--where", "seed==1").stdout.count("s/counting") == 2
    assert "no rows" in swept.review("list", "--where", "status=paused").stdout


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (("list", "--where", "status"), "expected KEY=VALUE"),
        (("list", "--where", "=done"), "expected KEY=VALUE"),
        (("list", "--where", "wall_s<soon"), "expected a number after <, got 'soon'"),
        (("list", "--sort", "sced"), "no column, metric or configuration key 'sced' in any run; did you mean 'seed'?"),
        (("list", "--where", "xyz=1"), "or a configuration key"),
        (("sweep", "t"), "no sweep 't' in"),
        (("sweep", "tests"), "tests is no sweep: expected a folder with a folder for each job"),
        (("sweep", "s", "--sort", "scroe_m"), "did you mean 'score_m'?"),
        (("compare", "latest"), "expected two runs or more"),
        (("compare", "s", "nowhere"), "no run or sweep 'nowhere'"),
        (("compare", "20", "s"), "begins the names of 2 runs"),
        (("compare", "s", "--html", "tests"), "cannot write tests"),
        (("compare", "s", "--html", "."), "cannot write ."),
    ],
)
def test_a_mistake_is_told_in_one_line(swept, arguments, told):
    result = swept.review(*arguments)
    assert result.returncode == 2
    assert told in result.stderr
    assert len(result.stderr.splitlines()) == 1


def test_nothing_there_is_told(toy):
    assert "no runs in" in toy.review("list", "--jobs").stdout
    for arguments in (("compare", "latest", "s"), ("sweep", "latest")):
        result = toy.review(*arguments)
        assert result.returncode == 2
        assert "make one with" in result.stderr


def test_sweep_prints_what_varies_why_jobs_failed_and_what_to_type(swept):
    shown = swept.review("sweep", "s").stdout
    assert "6 jobs (4 done, 2 failed)" in shown
    assert "the same in all: workflow=trials, trying.fail_at=[1], commit=" in shown
    head = next(line for line in shown.splitlines() if "score_m" in line)
    assert head.split()[:4] == ["seed", "counting.count", "status", "score_m"]
    assert "score_m (m)" in head
    assert "wall_s (s)" in head
    assert shown.count("trying: ArithmeticError: cannot try 1") == 2
    (command,) = (line for line in shown.splitlines() if "to finish, type: " in line)
    assert command.startswith("2 of 6 jobs are not done")
    assert command.endswith("'trying.fail_at=[1]'")
    everything = swept.review("sweep", "s", "--all", "--where", "status=failed").stdout
    assert sum(line.split()[1:3] == ["trials", "1"] for line in everything.splitlines()) == 2
    assert "commit" in everything


def test_sweep_writes_its_table_and_a_page_with_all_of_it(copied):
    sweep = copied.outputs / "sweeps" / "s"
    (sweep / "sweep.parquet").unlink()
    assert copied.review("sweep", str(sweep)).returncode == 0
    assert len(pd.read_parquet(sweep / "sweep.parquet")) == 6
    page = (sweep / "sweep.html").read_text()
    assert "score_m (m) over counting.count: diamonds are means, circles jobs (2 for each value)" in page
    assert "95 % interval (t) over seed" in page
    assert page.count("data:image/png;base64,") == 1
    assert "Traceback (most recent call last):" in page
    assert "ArithmeticError: cannot try 1" in page
    links = re.findall(r'href="(\./[^"]*)"', page)
    assert len(links) == 6 + 2
    for link in links:
        assert (sweep / link.replace("%3D", "=").replace("%2C", ",").replace("%5B", "[").replace("%5D", "]")).is_file()


def test_two_axes_make_a_grid_and_lists_are_values(tmp_path):
    command = Command(tmp_path / "outputs", *TRIALS)
    assert command(*ALONE, "sweep=g", "counting.count=3,5", "trying.fail_at=[],[7,8]", "seed=0,1").returncode == 0
    shown = command.review("sweep", "latest").stdout
    assert "[7,8]" in shown
    page = (command.outputs / "sweeps" / "g" / "sweep.html").read_text()
    assert "score_m (m): mean of the jobs in each cell (2)." in page
    assert page.count("data:image/png;base64,") == 3


def test_sweep_of_odd_jobs(copied):
    """Without ledger, damaged, killed at once, without metrics, with text or nan as metric, and another workflow."""
    ledger = ledger_of(job(copied, "seed=0", "counting.count=3"))
    change(job(copied, "seed=0", "counting.count=3"), metrics={"score_m": {"value": float("nan"), "unit": "m"}})
    change(job(copied, "seed=0", "counting.count=4"), metrics={"best": {"value": "gp", "unit": "1"}})
    (job(copied, "seed=2", "counting.count=3") / "run.json").write_text("{")
    (job(copied, "seed=1", "counting.count=3") / "run.json").unlink()
    change(job(copied, "seed=1", "counting.count=4"), status="running", error=None)
    odd = copied.outputs / "sweeps" / "s" / "a job's 50% <b>"
    odd.mkdir()
    (odd / "run.json").write_text(json.dumps({**ledger, "metrics": {}, "git": None}))
    (copied.outputs / "sweeps" / "s" / "notes").mkdir()
    shown = copied.review("sweep", "s")
    assert shown.returncode == 0, shown.stderr
    for word in ("unreadable", "not begun", "killed", "no ledger", "4 done"):
        assert word in shown.stdout
    page = (copied.outputs / "sweeps" / "s" / "sweep.html").read_text()
    assert "<b>" not in page
    assert "nothing to draw" in page or "data:image/png" in page
    listed = copied.review("list", "--jobs").stdout
    assert "unreadable" in listed
    assert copied.review("compare", "s").returncode == 0


def test_one_job_and_no_metric(toy):
    assert toy(*ALONE, "sweep=one", "seed=3").returncode == 0
    shown = toy.review("sweep", "one")
    assert shown.returncode == 0, shown.stderr
    assert "1 job (1 done)" in shown.stdout
    assert "Metrics" not in (toy.outputs / "sweeps" / "one" / "sweep.html").read_text()
    alone = toy.review("compare", "one")
    assert alone.returncode == 2
    assert "expected two runs or more" in alone.stderr


def test_jobs_with_different_workflows(toy):
    toy.fixed = tuple(each for each in toy.fixed if not each.startswith("workflow"))
    assert toy(*ALONE, "sweep=w", "workflow=toy,trials", "seed=0,1").returncode == 0
    shown = toy.review("sweep", "w")
    assert shown.returncode == 0, shown.stderr
    assert "trials" in shown.stdout
    compared = toy.review("compare", "w")
    assert compared.returncode == 0, compared.stderr
    assert "absent" in compared.stdout


def test_a_sweep_that_cannot_be_written_is_told_after_what_can_be_told(copied):
    page = copied.outputs / "sweeps" / "s" / "sweep.html"
    page.unlink(missing_ok=True)
    page.mkdir()
    result = copied.review("sweep", "s")
    assert result.returncode == 2
    assert "(4 done, 2 failed, 1 no ledger)" in result.stdout
    assert f"cannot write {page}" in result.stderr
    assert len(result.stderr.splitlines()) == 1


def test_compare_lists_differences_alone(swept, tmp_path):
    page = tmp_path / "page.html"
    one, two = (each.name for each in swept.runs)
    shown = swept.review("compare", one, two, "--html", str(page)).stdout
    assert f"page: {page}" in shown
    rows = [line.split() for line in shown.splitlines()]
    assert ["seed", "5", "6"] in rows
    assert ["counting.label", "few", "other"] in rows
    assert not any(row[:1] == ["counting.count"] for row in rows)
    assert "score_m (m)" in shown
    assert "2 values differ in 1 row that all have" in shown
    assert "+1 (+20.0%)" in shown
    assert "Code, libraries, machines: no difference" in shown
    everything = swept.review("compare", one, two, "--all", "--rows", "500").stdout
    assert "counting.count" in everything
    assert "library.pandas" in everything


def test_compare_tells_equal_tables(done):
    done("counting.label=other")
    one, two = (each.name for each in done.runs)
    shown = done.review("compare", one, two).stdout
    assert "total: the same to the byte in all runs that have it" in shown
    assert "the same to the byte in all: numbers, doubles, halves, total" in shown
    assert "Tables that differ: none" in shown
    assert (done.outputs / "reviews" / f"compare-{one}_vs_{two}.html").is_file()


def test_runs_that_differ_in_seed_alone_are_one_line_with_a_band(swept):
    shown = swept.review("compare", "s", "latest")
    assert shown.returncode == 0, shown.stderr
    page = (swept.outputs / "reviews" / "compare-s_vs_latest.html").read_text()
    assert "Lines are means, bands 95 % intervals of the mean (t) over runs" in page
    lines = re.search(r"n at each point.*?</table>", page, re.DOTALL).group()
    assert lines.count("<tr>") == 3
    for label in ("count=3", "count=4"):
        assert label in lines
    first = pd.concat(
        pd.read_parquet(job(swept, f"seed={seed}", "counting.count=3") / "tables" / "numbers.parquet").iloc[:1]
        for seed in (0, 2)
    )["draw"]
    half = 12.7062 * first.std() / 2**0.5
    assert f"{first.mean():.4g} ± {half:.2g} at 0" in lines


def test_a_copy_of_a_run_counts_once(copied):
    twin = copied.outputs / "runs" / "twin"
    shutil.copytree(copied.runs[0], twin)
    shown = copied.review("compare", copied.runs[0].name, "twin")
    assert shown.returncode == 0, shown.stderr
    assert "no key differs" in shown.stdout
    (page,) = (copied.outputs / "reviews").glob("*twin*")
    assert "counted once" in page.read_text()


def test_runs_of_another_version_are_compared_as_far_as_can_be(copied):
    (copied.runs[0] / "config.yaml").unlink()
    (copied.runs[1] / "tables" / "tried.parquet").write_bytes(b"damaged")
    facts = ledger_of(copied.runs[0])
    change(copied.runs[0], **{key: None for key in ("git", "machine", "metrics", "seconds") if key in facts})
    shown = copied.review("compare", *(each.name for each in copied.runs))
    assert shown.returncode == 0, shown.stderr
    assert "cannot be read" in shown.stdout or "tried" in shown.stdout
