"""Copies of runs and sweeps in MLflow: what they tell, live and afterwards, and what a tracker that fails costs."""

import importlib.util
import socket
import subprocess
import sys
import threading
import time
import urllib.request
import warnings
from contextlib import suppress
from pathlib import Path

import pytest

from pipeline.files import hash_file
from pipeline.tracking.entries import read_entry, read_sweep
from tests.pipeline.conftest import ALONE, CONFIG, TOY, Toy, success, the_only_line

TRIALS = (*CONFIG, "workflow=trials", "figures=[]", "workers=1")
TRACKED = "tracking=mlflow"
needs_mlflow = [
    pytest.mark.slow,
    pytest.mark.skipif(
        importlib.util.find_spec("mlflow") is None, reason="MLflow is not installed: pip install -e '.[tracking]'"
    ),
]


@pytest.fixture
def trials(tmp_path):
    """The command with the toy workflow whose metrics and curve are declared."""
    return Toy(tmp_path / "outputs", *TRIALS)


def test_a_runs_folder_holds_all_that_a_tracker_is_told(trials):
    success(trials, "seed=3")
    (folder,) = trials.runs
    entry = read_entry(folder)
    assert entry.params["seed"] == "3"
    assert entry.params["counting.count"] == "6"
    assert not {"outputs", "workers", "workflow.curves.draws_m.x"} & {*entry.params}
    assert (entry.tags["status"], entry.tags["kind"], entry.tags["workflow"]) == ("done", "run", "trials")
    assert {"commit", "dirty", "host", "command"} <= {*entry.tags}
    values = {each.name: each.value for each in entry.metrics}
    assert 3 < values["score_m"] < 4
    assert values["wall_s"] > 0
    assert [(each.name, each.step) for each in entry.series] == [("draws_m", step) for step in range(6)]
    assert entry.files["tables/tried.parquet"] == hash_file(folder / "tables/tried.parquet")
    assert {"run.json", "config.yaml", "report.html", "log.txt"} <= {*entry.files}
    assert [(each.name, each.read_by, each.rows) for each in entry.datasets] == [("numbers", "trying", 6)]
    assert entry.datasets[0].sha256 == hash_file(folder / "tables/numbers.parquet")
    assert read_entry(folder) == entry


def test_a_failed_job_is_told_with_its_reason_and_its_sweep(trials):
    assert trials(*ALONE, "sweep=s", "seed=0,1", "trying.fail_at=[1]").returncode == 1
    sweep = trials.outputs / "sweeps/s"
    told = read_sweep(sweep)
    assert (told.status, told.tags["jobs"], [*told.files]) == ("failed", "1 done, 1 failed", ["sweep.parquet"])
    (failed,) = (job for job in sweep.glob("*seed=1*"))
    entry = read_entry(failed)
    assert (entry.status, entry.within, entry.tags["sweep"]) == ("failed", told.key, "s")
    assert "cannot try 1" in entry.tags["error"]
    assert entry.key.startswith(told.key)


def test_a_missing_extra_is_one_line_before_anything_runs(trials, monkeypatch):
    find = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name, *more: None if name == "mlflow" else find(name, *more)
    )
    for arguments in ((TRACKED,), (TRACKED, "seed=0,1", "hydra/launcher=basic", "-m")):
        assert "pip install -e '.[tracking]'" in the_only_line(trials(*arguments, apart=False))
        assert not trials.outputs.exists()
    success(trials)
    assert "pip install -e '.[tracking]'" in the_only_line(trials.review("export", "--to", "mlflow"))


def test_an_address_with_a_password_is_refused_as_folders_would_keep_it(trials, monkeypatch):
    find = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name, *more: name == "mlflow" or find(name, *more))
    line = the_only_line(trials(TRACKED, "tracking.uri='http://me:secret@lab:5000'", apart=False))
    assert "MLFLOW_TRACKING_PASSWORD" in line


def read_back(uri, experiment="pamid"):
    """Return what MLflow's own client reads of each run of an experiment, by its name, without times and IDs."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from mlflow.tracking import MlflowClient

        client = MlflowClient(uri)
        number = client.get_experiment_by_name(experiment).experiment_id
        runs = client.search_runs([number])
        names = {run.info.run_id: run.info.run_name for run in runs}
        return {run.info.run_name: _read_run(client, run, names) for run in runs}


def _read_run(client, run, names):
    number = run.info.run_id
    tags = dict(run.data.tags)
    parent = tags.pop("mlflow.parentRunId", "")
    return {
        "status": run.info.status,
        "parent": names.get(parent),
        "params": run.data.params,
        "tags": tags,
        "series": {
            name: [(each.step, each.value) for each in client.get_metric_history(number, name)]
            for name in run.data.metrics
        },
        "datasets": {(each.dataset.name, each.dataset.digest) for each in run.inputs.dataset_inputs},
        "files": {path: hash_file(Path(client.download_artifacts(number, path))) for path in _list(client, number)},
    }


def _list(client, number, folder=None):
    for each in client.list_artifacts(number, folder):
        yield from _list(client, number, each.path) if each.is_dir else [each.path]


class TestMlflow:
    """With MLflow itself."""

    pytestmark = needs_mlflow

    def test_a_run_is_read_back_with_its_figures(self, tmp_path):
        toy = Toy(tmp_path / "outputs", *TOY, "figures=[png]")
        assert "sent to MLflow" in success(toy, TRACKED, "tracking.within_s=120")
        (folder,) = toy.runs
        (found,) = read_back(f"sqlite:///{toy.outputs}/tracking/mlflow.db").values()
        entry = read_entry(folder)
        assert found["status"] == "FINISHED"
        assert found["params"] == entry.params
        assert found["files"] == entry.files
        assert any(path.startswith("figures/") for path in found["files"])
        assert {name for name, _ in found["datasets"]} == {each.name for each in entry.datasets}

    def test_what_is_sent_live_is_what_export_sends_afterwards(self, trials, tmp_path):
        line = (*ALONE, "sweep=s", "seed=0,1,2", "trying.fail_at=[1]", "trying.pause_s=1")
        result = trials(*line, TRACKED, "tracking.within_s=120")
        assert result.returncode == 1
        assert "sent to MLflow" in result.stdout
        live = read_back(f"sqlite:///{trials.outputs}/tracking/mlflow.db")
        assert len(live) == 4
        jobs = {name: each for name, each in live.items() if name != "s"}
        assert {each["parent"] for each in jobs.values()} == {"s"}
        assert sorted(each["status"] for each in jobs.values()) == ["FAILED", "FINISHED", "FINISHED"]
        assert all(len(each["series"]["draws_m"]) == 6 for each in jobs.values())
        other = f"sqlite:///{tmp_path}/other.db"
        export = ("export", "--to", "mlflow", "--uri", other)
        assert "4 new" in trials.review(*export, "s").stdout
        assert read_back(other) == live
        assert "4 unchanged" in trials.review(*export).stdout
        assert read_back(other) == live
        with_mended = trials(*line, TRACKED, "tracking.within_s=120", "trying.fail_at=[]")  # another job, by its name
        assert with_mended.returncode == 0
        assert len(read_back(f"sqlite:///{trials.outputs}/tracking/mlflow.db")) == 7

    def test_a_server_that_stops_amid_a_sweep_costs_no_job_and_gets_the_rest_later(self, trials, relay):
        uri = (TRACKED, f"tracking.uri={relay.uri}", "tracking.within_s=4")
        sweep = (*ALONE, "sweep=s", "seed=range(3)", "trying.pause_s=6", *uri)
        process = trials.start(*sweep)
        jobs = trials.outputs / "sweeps/s"
        while not read_names(relay.server):
            assert process.poll() is None
            time.sleep(0.5)
        relay.close()
        output, errors = process.communicate(timeout=300)
        assert process.returncode == 0, errors
        assert "3 done" in output
        (line,) = errors.strip().splitlines()
        assert line.startswith("not sent to MLflow: ")
        assert line.endswith(f"export --to mlflow --uri {relay.uri} s")
        assert len([*jobs.glob("seed=*/run.json")]) == 3
        relay.open()
        assert "sent to MLflow" in success(trials, "seed=7", *uri[:2], "tracking.within_s=120")
        found = read_back(relay.uri)
        assert {each["status"] for each in found.values()} == {"FINISHED"}
        assert len(found) == 5

    @pytest.mark.parametrize("how", ["closed", "silent"])
    def test_a_server_that_is_down_or_never_answers_delays_a_run_by_less_than_was_said(self, trials, how):
        with socket.create_server(("127.0.0.1", 0)) as silent:
            uri = f"http://127.0.0.1:{silent.getsockname()[1]}"
            if how == "closed":
                silent.close()
            begun = time.monotonic()
            success(trials, "seed=1")
            took_s = time.monotonic() - begun
            begun = time.monotonic()
            result = trials("seed=2", TRACKED, f"tracking.uri={uri}", "tracking.within_s=3")
            delay_s = time.monotonic() - begun - took_s
        assert result.returncode == 0
        assert "not sent to MLflow" in result.stderr
        assert "done: " in result.stdout
        assert delay_s < 3 + 2  # s, of a busy machine
        (mark,) = (trials.outputs / "tracking/.not_sent").iterdir()
        assert uri in mark.read_text()

    def test_without_tracking_nothing_of_it_is_imported(self, trials):
        line = [sys.executable, "-X", "importtime", *trials.line()[1:]]
        told = subprocess.run(line, capture_output=True, text=True, check=True).stderr
        assert "mlflow" not in told
        assert "pipeline.tracking.entries" not in told


class Relay:
    """A port before MLflow's server that can be closed and opened again."""

    def __init__(self, server):
        self.server = server
        self.sockets = []
        self.port = 0
        self.open()
        self.uri = f"http://127.0.0.1:{self.port}"

    def open(self):
        listener = socket.create_server(("127.0.0.1", self.port))
        self.port = listener.getsockname()[1]
        self.sockets = [listener]
        threading.Thread(target=self._accept, args=(listener,), daemon=True).start()

    def close(self):
        for each in self.sockets:
            with suppress(OSError):
                each.shutdown(socket.SHUT_RDWR)
            each.close()

    def _accept(self, listener):
        host, _, port = self.server.removeprefix("http://").partition(":")
        with suppress(OSError):
            while True:
                client, _ = listener.accept()
                server = socket.create_connection((host, int(port)))
                self.sockets += [client, server]
                for pair in ((client, server), (server, client)):
                    threading.Thread(target=self._pass_on, args=pair, daemon=True).start()

    @staticmethod
    def _pass_on(source, target):
        with suppress(OSError):
            while data := source.recv(65536):
                target.sendall(data)
            target.shutdown(socket.SHUT_WR)


@pytest.fixture
def relay(tmp_path):
    """MLflow's own server behind a relay."""
    with socket.create_server(("127.0.0.1", 0)) as found:
        port = found.getsockname()[1]
    folder = tmp_path / "server"
    folder.mkdir()
    line = [sys.executable, "-m", "mlflow", "server", "--backend-store-uri", f"sqlite:///{folder}/mlflow.db"]
    line += ["--artifacts-destination", f"{folder}/artifacts", "--port", str(port), "--workers", "1"]
    process = subprocess.Popen(line, cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    uri = f"http://127.0.0.1:{port}"
    try:
        while True:
            try:
                urllib.request.urlopen(f"{uri}/health", timeout=1).close()
                break
            except OSError:
                assert process.poll() is None
                time.sleep(0.5)
        made = Relay(uri)
        yield made
        made.close()
    finally:
        process.terminate()
        process.wait()


def read_names(uri):
    try:
        return read_back(uri)
    except AttributeError:  # no experiment yet
        return {}
