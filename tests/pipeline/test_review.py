"""Review of many runs by real commands: lists, sweeps, comparisons, reports of failures, on outputs of every kind."""

import json
import re
import shutil
from urllib.parse import unquote

import pandas as pd
import pyarrow.parquet
import pytest
import statsmodels.formula.api as smf
from scipy.stats import ttest_ind, ttest_rel
from statsmodels.stats.anova import anova_lm

from pipeline.files import TEMPORARY_SUFFIX
from pipeline.printing import format_p
from pipeline.review.sweep_view import Sweep, compare_values, describe_extremes, propose_seeds
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


def shown(command, *arguments):
    """Return what a review prints that ends well."""
    result = command.review(*arguments)
    assert result.returncode == 0, result.stderr
    return result.stdout


def refused(command, *arguments):
    """Return the one line that refuses a review."""
    result = command.review(*arguments)
    (line,) = result.stderr.splitlines()
    assert result.returncode == 2
    return line


def job(command, *parts):
    """Return the folder of the job whose name has all these parts."""
    folders = (command.outputs / "sweeps" / "s").glob("[!.]*/")
    (found,) = (each for each in folders if {*parts} <= {*each.name.split(",")})
    return found


def change(folder, **facts):
    """Change facts of a run's ledger."""
    path = folder / "run.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), **facts}))


def test_list_has_a_line_for_a_sweep_or_for_each_of_its_jobs(copied):
    listed = shown(copied, "list")
    assert listed.count(" s/ ") == 1
    assert "4 of 6 jobs, 2 failed" in listed
    assert "s/counting" not in listed
    jobs = shown(copied, "list", "--jobs")
    assert jobs.count("s/counting.count=") == 6
    assert " s/ " not in jobs
    assert "first 2 of 8 rows; --rows 8 shows all" in shown(copied, "list", "--jobs", "--rows", "2")
    shutil.rmtree(job(copied, "seed=2", "counting.count=3"))
    listed = shown(copied, "list")
    assert "3 of 6 jobs, 2 failed, 1 not begun" in listed
    elsewhere = Command(copied.outputs.with_name("elsewhere"))
    assert shown(elsewhere, "list", "--outputs", str(copied.outputs)) == listed
    place = f"-m pipeline.review --outputs {copied.outputs} "
    assert f"{place}sweep NAME" in listed
    assert f"{place}show " in shown(copied, "show", "latest")


def test_list_is_sorted_and_chosen_from_by_columns_metrics_and_configuration(swept):
    done = shown(swept, "list", "--jobs", "--sort", "-score_m", "--where", "status=done")
    scores = [float(each) for each in re.findall(r"stages +(\d+\.\d+)", done)]
    assert len(scores) == 6
    assert scores == sorted(scores, reverse=True)
    some = shown(swept, "list", "--jobs", "--where", "counting.count=3", "--where", "seed<2", "--sort", "seed")
    assert some.count("s/counting.count=3") == 2
    assert "counting.count=4" not in some
    for condition in ("run~SEED=1", "seed==1"):
        assert shown(swept, "list", "--jobs", "--where", condition).count("s/counting") == 2
    assert "no rows" in shown(swept, "list", "--where", "status=paused")


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
    assert told in refused(swept, *arguments)


def test_sweep_prints_what_varies_why_jobs_failed_and_what_to_type(swept):
    told = shown(swept, "sweep", "s")
    assert "6 jobs (4 done, 2 failed)" in told
    assert "the same in all: workflow=trials, trying.fail_at=[1], commit=" in told
    head = next(line for line in told.splitlines() if "score_m" in line)
    assert head.split()[:5] == ["seed", "counting.count", "status", "score_m", "wall_s"]
    assert told.count("trying: ArithmeticError: cannot try 1") == 2
    (command,) = (line for line in told.splitlines() if "to finish, type: " in line)
    assert command.startswith("2 of 6 jobs are not done")
    assert command.endswith("'trying.fail_at=[1]'")
    everything = shown(swept, "sweep", "s", "--all", "--where", "status=failed")
    assert sum(line.split()[1:3] == ["trials", "1"] for line in everything.splitlines()) == 2
    assert "commit" in everything


def test_sweep_writes_its_table_and_a_page_with_all_of_it_or_tells_the_rest(copied):
    sweep = copied.outputs / "sweeps" / "s"
    (sweep / "sweep.parquet").unlink()
    shown(copied, "sweep", str(sweep))
    assert len(pd.read_parquet(sweep / "sweep.parquet")) == 6
    page = (sweep / "sweep.html").read_text()
    assert "score_m over counting.count: diamonds are means, circles jobs (2 for each value)" in page
    assert "95 % interval (t) over seed" in page
    assert page.count("data:image/png;base64,") == 1
    assert "Traceback (most recent call last):" in page
    assert "ArithmeticError: cannot try 1" in page
    links = re.findall(r'href="(\./[^"]*)"', page)
    assert len(links) == 6 + 2
    assert all((sweep / unquote(link)).is_file() for link in links)
    (sweep / "sweep.html").unlink()
    (sweep / "sweep.html").mkdir()
    result = copied.review("sweep", "s")
    assert (result.returncode, "(4 done, 2 failed, 1 no ledger)" in result.stdout) == (2, True)
    (line,) = result.stderr.splitlines()
    assert f"cannot write {sweep / 'sweep.html'}" in line


def test_two_axes_make_a_grid_and_lists_are_values(tmp_path):
    command = Command(tmp_path / "outputs", *TRIALS)
    assert command(*ALONE, "sweep=g", "counting.count=3,5", "trying.fail_at=[],[7,8]", "seed=0,1").returncode == 0
    assert "[7,8]" in shown(command, "sweep", "latest")
    page = (command.outputs / "sweeps" / "g" / "sweep.html").read_text()
    assert "score_m: mean of the jobs in each cell (2)." in page
    assert page.count("data:image/png;base64,") == 3


def test_ratios_declared_in_percent_are_shown_so_and_asked_for_either_way(copied):
    for number, seed in enumerate(("0", "1", "2")):
        for count in ("3", "4"):
            rate = {"value": 0.011 * (number + 1), "unit": "1", "percent": True, "title": "Error at the end"}
            change(job(copied, f"seed={seed}", f"counting.count={count}"), metrics={"rate": rate})
    listed = shown(copied, "list", "--jobs", "--where", "rate<0.03")
    assert "rate (%)" in listed
    assert {"1.1", "2.2"} <= {*listed.split()}
    assert "3.3" not in listed.split()
    assert shown(copied, "list", "--jobs", "--where", "rate<3%") == listed
    told = shown(copied, "sweep", "s")
    assert {"(%)", "1.1", "2.2", "3.3"} <= {*told.split()}
    page = (copied.outputs / "sweeps" / "s" / "sweep.html").read_text()
    assert "Error at the end (%) over counting.count" in page
    kept = pyarrow.parquet.read_table(copied.outputs / "sweeps" / "s" / "sweep.parquet")
    assert kept.column("rate").to_pylist() == pytest.approx([0.011, 0.022, 0.033] * 2)
    assert kept.schema.field("rate").metadata == {b"unit": b"1", b"title": b"Error at the end", b"shown in": b"%"}
    compared = shown(copied, "compare", "s").split()
    assert {"(%)", "3.3"} <= {*compared}


def test_sweep_of_odd_jobs(copied):
    """Without ledger, damaged, killed at once, without metrics, with text or nan as metric, and another workflow."""
    ledger = ledger_of(job(copied, "seed=0", "counting.count=3"))
    change(job(copied, "seed=0", "counting.count=3"), metrics={"score_m": {"value": float("nan"), "unit": "m"}})
    change(job(copied, "seed=0", "counting.count=4"), metrics={"best": {"value": "gp", "unit": "1"}})
    (job(copied, "seed=2", "counting.count=3") / "run.json").write_text("{")
    (job(copied, "seed=1", "counting.count=3") / "run.json").unlink()
    change(job(copied, "seed=1", "counting.count=4"), status="running", error=None)
    sweep = copied.outputs / "sweeps" / "s"
    odd = sweep / "a job's 50% <b>"
    odd.mkdir()
    (odd / "run.json").write_text(json.dumps({**ledger, "metrics": {}, "git": None}))
    (sweep / "notes").mkdir()
    told = shown(copied, "sweep", "s")
    for word in ("unreadable", "not begun", "killed", "no ledger", "4 done"):
        assert word in told
    page = (sweep / "sweep.html").read_text()
    assert "<b>" not in page
    assert "nothing to draw" in page or "data:image/png" in page
    assert "unreadable" in shown(copied, "list", "--jobs")
    shown(copied, "compare", "s")


def test_no_job_one_without_metric_and_jobs_with_different_workflows(toy):
    assert "no outputs folder" in refused(toy, "list", "--jobs")
    for arguments in (("compare", "latest", "s"), ("sweep", "latest")):
        assert "make one with" in refused(toy, *arguments)
    assert toy(*ALONE, "sweep=one", "seed=3").returncode == 0
    assert "1 job (1 done)" in shown(toy, "sweep", "one")
    assert "Metrics" not in (toy.outputs / "sweeps" / "one" / "sweep.html").read_text()
    assert "expected two runs or more" in refused(toy, "compare", "one")
    toy.fixed = tuple(each for each in toy.fixed if not each.startswith("workflow"))
    assert toy(*ALONE, "sweep=w", "workflow=toy,trials", "seed=0,1").returncode == 0
    assert "trials" in shown(toy, "sweep", "w")
    told = shown(toy, "compare", "w")
    (sections,) = (line.split() for line in told.splitlines() if line.split()[:1] == ["sections"])
    assert {"doubling", "trying"} < {*sections}


def test_compare_lists_differences_alone(swept, tmp_path):
    page = tmp_path / "page.html"
    one, two = (each.name for each in swept.runs)
    told = shown(swept, "compare", one, two, "--html", str(page))
    rows = [line.split() for line in told.splitlines()]
    assert ["seed", "5", "6"] in rows
    assert ["counting.label", "few", "other"] in rows
    assert not any(row[:1] == ["counting.count"] for row in rows)
    for part in (f"page: {page}", "score_m", "2 values differ in 1 row that all have", "+1 (x 1.2)"):
        assert part in told
    assert "Code, libraries, machines: no difference" in told
    everything = shown(swept, "compare", one, two, "--all", "--rows", "500")
    assert {"counting.count", "library.pandas"} <= {*everything.split()}


def test_compare_tells_equal_tables(done):
    done("counting.label=other")
    one, two = (each.name for each in done.runs)
    told = shown(done, "compare", one, two)
    assert "total: the same to the byte in all runs that have it" in told
    assert "the same to the byte in all: numbers, doubles, halves, total" in told
    assert "Tables that differ: none" in told
    assert (done.outputs / "reviews" / f"compare-{one}_vs_{two}.html").is_file()


def test_runs_that_differ_in_seed_alone_are_one_line_with_a_band(swept):
    shown(swept, "compare", "s", "latest")
    page = (swept.outputs / "reviews" / "compare-s_vs_latest.html").read_text()
    assert "Lines are means, bands 95 % intervals of the mean (t) over runs" in page
    lines = re.search(r"n at each point.*?</table>", page, re.DOTALL).group()
    assert [lines.count(each) for each in ("<tr>", "count=3", "count=4")] == [3, 1, 1]
    first = pd.concat(
        pd.read_parquet(job(swept, f"seed={seed}", "counting.count=3") / "tables" / "numbers.parquet").iloc[:1]
        for seed in (0, 2)
    )["draw"]
    mean, half = first.mean(), 12.7062 * first.std() / 2**0.5
    assert f"{mean:.4g} ({max(mean - half, 0):.3g} to {mean + half:.3g}) at 0" in lines  # a draw is not below zero


def test_groups_of_the_same_curve_are_one_line(copied):
    assert copied("seed=5", "counting.label=other").returncode == 0
    shown(copied, "compare", copied.runs[0].name, "latest", "--html", str(copied.outputs / "page.html"))
    lines = re.search(r"n at each point.*?</table>", (copied.outputs / "page.html").read_text(), re.DOTALL).group()
    assert [lines.count(each) for each in ("<tr>", "label=other")] == [1, 1]


def test_a_copy_of_a_run_counts_once_and_runs_of_another_version_are_compared_as_far_as_can_be(copied):
    one, two = copied.runs
    shutil.copytree(one, copied.outputs / "runs" / "twin")
    assert "no key differs" in shown(copied, "compare", one.name, "twin")
    (page,) = (copied.outputs / "reviews").glob("*twin*")
    assert "counted once" in page.read_text()
    (one / "config.yaml").unlink()
    (two / "tables" / "tried.parquet").write_bytes(b"damaged")
    change(one, **{key: None for key in ("git", "machine", "metrics", "seconds") if key in ledger_of(one)})
    told = shown(copied, "compare", one.name, two.name)
    assert "cannot be read" in told or "tried" in told


@pytest.mark.parametrize(
    ("frames", "told"),
    [
        (({"told": ["a", "b"]}, {"told": ["b", "c"]}), "c - yes"),
        (({"x": [0.5, 0.5]}, {"x": [1.5, 1.5]}), "no columns name a row, so that rows cannot be compared"),
        (({"n": [1, 2], "x": [0.5, 1.0]}, {"n": [3, 4], "x": [0.5, 1.0]}), "no row is in all runs; 4 rows are in some"),
    ],
)
def test_tables_of_sentences_and_without_common_rows_are_compared_too(copied, frames, told):
    for run, values in zip(copied.runs, frames, strict=True):
        pd.DataFrame(values).to_parquet(run / "tables" / "tried.parquet")
    assert told in " ".join(shown(copied, "compare", *(run.name for run in copied.runs)).split())


@pytest.mark.parametrize(("shift", "told"), [(0.0, ": not told apart"), (5.0, ": told apart")])
@pytest.mark.parametrize("crossed", [True, False])
def test_values_of_a_key_are_told_apart_or_not_in_blocks_of_the_same_seed(shift, told, crossed, tmp_path):
    score = [1.0, 1.2, 0.8, 1.1, *(shift + each for each in (0.9, 1.3, 1.0, 1.2))]
    seeds = [0, 1, 2, 3] * 2 if crossed else [*range(8)]
    jobs = {"job": list("abcdefgh"), "gain": [1] * 4 + [2] * 4, "seed": seeds, "status": "done"}
    found = Sweep(tmp_path, pd.DataFrame({**jobs, "score": score, "wall_s": 1.0}), {"score": {"unit": "m"}})
    sentences = describe_extremes(found)
    assert sentences[0].startswith("score is least with gain=1, 1.02 (0.753 to 1.3) m, and most with gain=2, ")
    assert told in sentences[0]
    test = ttest_rel if crossed else ttest_ind
    assert f"{format_p(test(score[:4], score[4:]).pvalue)}, " in sentences[0]
    assert ("p < 0.0001" in sentences[0]) == (shift > 0.0)
    told = propose_seeds(found, ["-m", "seed=0,1", "gain=1,2"])
    assert told.endswith(f"-m pipeline -m gain=1,2 'seed=range({2 * len({*seeds})})'")


@pytest.mark.parametrize(
    ("second", "score", "told"),
    [
        ({"patch": [0, 1, 0, 1]}, [1.4, 1.4, 1.5, 1.5], "1.5 m: no seed varies, which tells nothing of chance."),
        (
            {"seed": [0, 1, 0, 1]},
            [1.4, 1.4, 1.5, 1.5],
            "1.5 to 1.5) m: seeds do not change the difference, which tells",
        ),
        ({"seed": [0, 0, 0, 0], "patch": [0, 1, 0, 1]}, [1.4, 1.6, 1.5, 1.7], "1.6 m: no seed varies, which"),
        (
            {"seed": [0, 1, 2, 3]},
            [1.4, 1.4, 1.5, 1.5],
            "1.5 to 1.5) m: seeds do not change the difference, which tells",
        ),
    ],
)
def test_what_no_seed_changes_is_no_evidence(second, score, told, tmp_path):
    jobs = {"job": list("abcd"), "share": [3, 3, 4, 4], **second, "status": "done"}
    found = Sweep(tmp_path, pd.DataFrame({**jobs, "score": score, "wall_s": 1.0}), {"score": {"unit": "m"}})
    assert told in describe_extremes(found)[0]


def test_jobs_of_one_seed_that_differ_in_another_key_are_one_value(tmp_path):
    jobs = {"job": [*range(8)], "share": [3] * 4 + [4] * 4, "seed": [0, 0, 1, 1] * 2, "patch": [0, 1] * 4}
    scores = {"score": [0.1, 0.1, 0.2, 0.2, 0.2, 0.2, 0.4, 0.4], "wall_s": 1.0}
    found = Sweep(tmp_path, pd.DataFrame({**jobs, "status": "done", **scores}), {"score": {"unit": "1", "low": "0"}})
    told = describe_extremes(found)[0]
    assert f"p = {ttest_rel([0.1, 0.2], [0.2, 0.4]).pvalue:.2g}, analysis of variance within the same seed" in told
    assert "share=3, 0.15 (0 to 0.785), and" in told


def test_blocks_of_three_values_are_analysed_as_by_regression(generator):
    values = generator.normal(size=(5, 3)) + generator.normal(size=(5, 1)) + [0.0, 0.4, 0.8]
    points = pd.DataFrame([(str(s), str(g), x) for s, row in enumerate(values) for g, x in enumerate(row)])
    points = points.set_axis(["seed", "gain", "value"], axis="columns")
    fitted = smf.ols("value ~ C(seed) + C(gain)", points).fit()
    expected = anova_lm(fitted).loc["C(gain)", "PR(>F)"]
    assert compare_values(points, "gain")[0] == pytest.approx(expected)
