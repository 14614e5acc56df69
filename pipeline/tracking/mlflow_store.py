"""Tells entries to MLflow: an `Entry` flows in, an MLflow run that shows the same flows out.

An MLflow run is found again by a tag that holds the entry's key, and one whose stamp is the entry's is left as it is:
sending twice changes nothing. MLflow lets no parameter and no point of a series be changed; where one did change, the
MLflow run is deleted (it can be restored in MLflow) and another one takes its place.
"""

from __future__ import annotations

import json
import logging
import os
import posixpath
import re
import tempfile
import urllib.error
import urllib.request
from collections import Counter
from collections.abc import Iterator, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

from filelock import FileLock

from pipeline.errors import PipelineError
from pipeline.ledger import FILE_NAME, Ledger, files_of
from pipeline.runs import live_status
from pipeline.tracking.destination import SQLITE, Destination
from pipeline.tracking.entries import (
    Dataset,
    Entry,
    Point,
    is_sweep,
    key_of,
    list_jobs,
    read_entry,
    read_sweep,
    stamp_of,
)

KEY, WITHIN, STAMP = "pamid.key", "pamid.within", "pamid.stamp"
STATUS = {"done": "FINISHED", "running": "RUNNING", "failed": "FAILED", "paused": "SCHEDULED"}
"""What MLflow calls a status; every other one is KILLED."""
STRANGE = re.compile(r"[^\w.\- /]")
LONGEST_NAME, LONGEST_PARAM, LONGEST_TAG, LONGEST_DIGEST, LONGEST_INPUT_TAG = 250, 6000, 8000, 16, 500
MOST_OF_A_CALL = {"tags": 100, "params": 100, "metrics": 900}
LOOK_S = 2.0
"""Longest wait for a sign of life of a server, s."""


class Store:
    """A connection to MLflow; an exception of any kind says that something could not be sent."""

    def __init__(self, destination: Destination, largest_file_mb: float, request_s: float, retries: int):
        """Import MLflow, which takes seconds, and connect; a request takes `request_s` at most, each try."""
        os.environ["MLFLOW_HTTP_REQUEST_TIMEOUT"] = str(max(1, round(request_s)))
        quiet = {"MLFLOW_DISABLE_TELEMETRY": "true", "DO_NOT_TRACK": "true"}
        os.environ.update({**quiet, "MLFLOW_HTTP_REQUEST_MAX_RETRIES": str(retries), **os.environ})
        from mlflow.tracking import MlflowClient

        logging.getLogger("mlflow").setLevel(logging.ERROR)
        logging.getLogger("alembic").setLevel(logging.ERROR)
        self.destination = destination
        self.largest_file_mb = largest_file_mb
        self._sent: dict[str, str] = {}
        self.look_for_server()
        destination.lock.parent.mkdir(parents=True, exist_ok=True)
        with FileLock(destination.lock):
            if destination.database and not destination.database.exists():
                _make_database(destination.database, MlflowClient)
            self.client = MlflowClient(destination.uri)
            self.experiment = self._find_experiment()

    def look_for_server(self) -> None:
        """Raise an OSError where a server gives no sign of life, which it need not be asked for long."""
        uri = self.destination.uri
        if not uri.startswith(("http://", "https://")):
            return
        try:
            urllib.request.urlopen(f"{uri.rstrip('/')}/health", timeout=LOOK_S).close()
        except urllib.error.HTTPError:
            return
        except OSError as error:
            why = error.reason if isinstance(error, urllib.error.URLError) else str(error)
            raise OSError(f"{uri} does not answer ({getattr(why, 'strerror', None) or why})") from None

    def send(self, folder: Path, looks: bool = True) -> Counter[str]:
        """Send a run, a job or a whole sweep; return how many are new, updated or unchanged, by these words.

        Where one does not look, the ledger is believed: a run whose process died is told as running.
        """
        with FileLock(self.destination.lock):
            if is_sweep(folder):
                return self._send_sweep(folder, looks)
            parent = self._put(read_sweep(folder.parent, looks))[1] if is_sweep(folder.parent) else None
            return Counter([self._put(read_entry(folder, looks), parent)[0]])

    def _send_sweep(self, folder: Path, looks: bool) -> Counter[str]:
        key = key_of(folder)
        if key not in self._sent:
            self._sent |= {run.data.tags[KEY]: run.data.tags.get(STAMP, "") for run in self._search(WITHIN, key)}
        told, parent = self._put(read_sweep(folder, looks))
        counts = Counter({told: 1})
        for job in list_jobs(folder):
            ledger = Ledger.look(job)
            if ledger is None:
                continue
            status = live_status(ledger) if looks else ledger.status
            same = self._sent.get(f"{key} {job.name}") == stamp_of(job, status)
            counts["unchanged" if same else self._put(read_entry(job, looks), parent)[0]] += 1
        return counts

    def _put(self, entry: Entry | None, parent: str | None = None) -> tuple[str, str | None]:
        """Make the MLflow run of an entry show it; return whether it is new, updated or unchanged, and its ID."""
        if entry is None:
            return "unchanged", None
        run = next(self._search(KEY, entry.key), None)
        self._sent[entry.key] = entry.stamp
        if run is not None and run.data.tags.get(STAMP) == entry.stamp:
            return "unchanged", str(run.info.run_id)
        if run is not None and _contradicts(run, entry):
            self.client.delete_run(run.info.run_id)
            run = None
        word = "new" if run is None else "updated"
        if run is None:
            begun = _milliseconds(entry.started)
            within = {WITHIN: entry.within} if entry.within else {}
            run = self.client.create_run(self.experiment, begun, {KEY: entry.key} | within, entry.name)
        number = str(run.info.run_id)
        left_out = self._log_files(number, entry) if entry.files else []
        self._log_values(run, entry, parent, left_out)
        if entry.datasets:
            self.client.log_inputs(number, [*map(_make_input, entry.datasets)])
        status = STATUS.get(entry.status, "KILLED")
        if status == "RUNNING":
            self.client.update_run(number, status)
        else:
            self.client.set_terminated(number, status, _milliseconds(entry.ended or entry.started))
        self.client.set_tag(number, STAMP, entry.stamp)
        return word, number

    def _log_values(self, run: Any, entry: Entry, parent: str | None, left_out: Sequence[str]) -> None:
        from mlflow.entities import Metric, Param, RunTag

        tags = {
            **{_fit(key): value[:LONGEST_TAG] for key, value in entry.tags.items()},
            "not_sent": ", ".join(left_out)[:LONGEST_TAG],
            "mlflow.note.content": entry.note[:LONGEST_TAG],
            "mlflow.source.type": "LOCAL",
            "mlflow.source.name": entry.tags.get("workflow", entry.tags.get("kind", "")),
            "mlflow.source.git.commit": entry.tags.get("commit", ""),
            "mlflow.parentRunId": parent or "",
        }
        params = [Param(key, value) for key, value in _fit_params(entry).items() if run.data.params.get(key) != value]
        known = run.data.metrics
        last = _last(entry.metrics) | _last(entry.series)
        points = [
            Metric(_fit(each.name), each.value, _milliseconds(each.time), each.step)
            for each in (*entry.metrics, *entry.series)
            if known.get(_fit(each.name)) != last[_fit(each.name)]
        ]
        logged = [RunTag(key, value) for key, value in tags.items() if run.data.tags.get(key, "") != value]
        batches: dict[str, Any] = {"tags": logged, "params": params, "metrics": points}
        for kind, items in batches.items():
            for start in range(0, len(items), MOST_OF_A_CALL[kind]):
                self.client.log_batch(run.info.run_id, **{kind: items[start : start + MOST_OF_A_CALL[kind]]})

    def _log_files(self, number: str, entry: Entry) -> list[str]:
        """Send the files that are not there yet, the ledger last; return those that are too large."""
        sent, left_out = self._read_sent(number), []
        for path, digest in sorted(entry.files.items(), key=lambda each: each[0] == FILE_NAME):
            file = entry.folder / path
            size_mb = file.stat().st_size / 1e6
            if size_mb > self.largest_file_mb:
                left_out.append(f"{path} ({size_mb:.0f} MB)")
            elif sent.get(path) != digest:
                self.client.log_artifact(number, str(file), str(Path(path).parent) if "/" in path else None)
        return left_out

    def _read_sent(self, number: str) -> dict[str, str]:
        """Return the hashes of the files that were sent, by the ledger that was sent after them."""
        try:
            if not any(each.path == FILE_NAME for each in self.client.list_artifacts(number)):
                return {}
            with tempfile.TemporaryDirectory() as folder:
                path = self.client.download_artifacts(number, FILE_NAME, folder)
                records = json.loads(Path(path).read_text(encoding="utf-8"))["stages"].values()
        except (OSError, ValueError, KeyError):
            return {}
        done = [each for each in records if each["status"] == "done"]
        return {file: facts["sha256"] for each in done for file, facts in files_of(each).items()}

    def _search(self, tag: str, value: str) -> Iterator[Any]:
        token = None
        told = value.replace("'", "_")
        while True:
            found = self.client.search_runs([self.experiment], f"tags.`{tag}` = '{told}'", page_token=token)
            yield from found
            if not (token := found.token):
                return

    def _find_experiment(self) -> str:
        name = self.destination.experiment
        found = self.client.get_experiment_by_name(name)
        if found is None:
            database = self.destination.database
            place = (database.absolute().parent / "artifacts").as_uri() if database else None
            kind = {"mlflow.experimentKind": "custom_model_development"}
            return str(self.client.create_experiment(name, place, kind))
        if found.lifecycle_stage != "active":
            raise PipelineError(f"experiment {name} was deleted in MLflow; restore it there, or choose another")
        return str(found.experiment_id)


def _make_database(path: Path, connect: Any) -> None:
    """Make a store that is whole or absent, as making its tables takes seconds in which this process may be stopped."""
    with tempfile.TemporaryDirectory(dir=path.parent, prefix=".making") as folder:
        connect(f"{SQLITE}{Path(folder) / path.name}")
        (Path(folder) / path.name).replace(path)


def _contradicts(run: Any, entry: Entry) -> bool:
    """Return whether an MLflow run holds what cannot be changed to what the entry says."""
    params, last = _fit_params(entry), _last(entry.series)
    changed = any(params.get(key) != value for key, value in run.data.params.items())
    return changed or any(run.data.metrics.get(name, value) != value for name, value in last.items())


def _fit_params(entry: Entry) -> dict[str, str]:
    """Return parameters as MLflow takes them; what is cut stands in config.yaml, which is sent too."""
    return {
        _fit(key): value if len(value) <= LONGEST_PARAM else f"{value[: LONGEST_PARAM - 4]} ..."
        for key, value in entry.params.items()
    }


def _fit(name: str) -> str:
    """Return a name as MLflow takes it."""
    plain = STRANGE.sub("_", name)[:LONGEST_NAME]
    return plain if posixpath.normpath(plain) == plain else plain.replace("/", "_")


def _last(points: Sequence[Point]) -> dict[str, float]:
    """Return the value of each metric at its last step."""
    return {_fit(each.name): each.value for each in sorted(points, key=lambda each: each.step)}


def _make_input(dataset: Dataset) -> Any:
    from mlflow.entities import Dataset as Named
    from mlflow.entities import DatasetInput, InputTag

    profile = None if dataset.rows is None else json.dumps({"num_rows": dataset.rows})
    source = json.dumps({"sha256": dataset.sha256})
    named = Named(dataset.name, dataset.sha256[:LONGEST_DIGEST], "sha256", source, profile=profile)
    return DatasetInput(named, [InputTag("mlflow.data.context", dataset.read_by[:LONGEST_INPUT_TAG])])


def _milliseconds(time: str) -> int:
    return round(datetime.fromisoformat(time).timestamp() * 1000)
