"""``python -m pipeline.tracking``: sends a command's runs while it works; started and ended by `follower`.

The destination flows in as JSON, folders to follow as lines of standard input, whose end is that of the command. Out
flows the exit code 0 where all was sent, else 1 with the reason on standard error.
"""

from __future__ import annotations

import json
import os
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from pipeline.ledger import FILE_NAME, Ledger
from pipeline.printing import shorten
from pipeline.runs import is_running
from pipeline.sweeps.launch import is_launched
from pipeline.tracking.destination import Destination
from pipeline.tracking.entries import is_sweep, list_jobs

if TYPE_CHECKING:
    from pipeline.tracking.mlflow_store import Store

PERIOD_S = 2.0
"""Between two looks at what changed, s."""
REST = 10
"""Of its own time to send, that it rests at least: much to send is sent more seldom."""
LONGEST_REASON = 160
NICENESS = 10
"""By which runs go before what tells of them."""


class Sender:
    """Sends the folders that it is told of, again and again, until the command that has them made ends."""

    def __init__(self, destination: Destination, largest_file_mb: float, request_s: float):
        self.destination = destination
        self.largest_file_mb = largest_file_mb
        self.request_s = request_s
        self.folders: list[Path] = []
        self.ended = threading.Event()
        self.reason = ""
        self._store: Store | None = None
        self._seen: dict[Path, list[tuple[str, int]]] = {}

    def listen(self) -> None:
        """Note the folders that standard input names, until it ends."""
        for line in sys.stdin:
            self.folders.append(Path(line.rstrip("\n")))
        self.ended.set()

    def follow(self) -> bool:
        """Send until the command ends, then once more; return whether nothing is left."""
        self._try(self._connect)
        took_s = 0.0
        while not self.ended.wait(max(PERIOD_S, REST * took_s)):
            begun = time.monotonic()
            self._try(self._send_changed)
            took_s = time.monotonic() - begun
        return self._try(self._send_all)

    def _try(self, send: Callable[[], object]) -> bool:
        try:
            send()
        except Exception as error:  # whatever it is, the runs are none of it
            self.reason = shorten((str(error).splitlines() or [type(error).__name__])[0], LONGEST_REASON)
            return False
        return True

    def _connect(self) -> Store:
        from pipeline.tracking.mlflow_store import Store

        if self._store is None:
            self._store = Store(self.destination, self.largest_file_mb, self.request_s, retries=0)
        else:
            self._store.look_for_server()
        return self._store

    def _send_changed(self) -> None:
        store = self._connect()
        for folder in list(self.folders):
            paths = [each / FILE_NAME for each in (list_jobs(folder) if is_sweep(folder) else [folder])]
            ledgers = [(str(each), each.stat().st_mtime_ns) for each in paths if each.exists()]
            if ledgers != self._seen.get(folder):
                store.send(folder, looks=False)
                self._seen[folder] = ledgers

    def _send_all(self) -> None:
        """Send how the command's own runs ended, then what earlier ones left, but for what others have at work."""
        store = self._connect()
        marked = self.destination.list_marked()
        left = [each for each in marked if not (is_launched(each) if is_sweep(each) else is_running(Ledger(each)))]
        for folder in [*self.folders, *(each for each in left if each not in self.folders)]:
            store.send(folder)
            self.destination.clear(folder)


def main() -> int:
    """Send as the first argument says; return the exit code."""
    os.nice(NICENESS)
    options = json.loads(sys.argv[1])
    destination = Destination(Path(options["outputs"]), options["uri"], options["experiment"])
    sender = Sender(destination, options["largest_file_mb"], options["within_s"] / 2)
    threading.Thread(target=sender.listen, daemon=True).start()
    if sender.follow():
        return 0
    print(sender.reason, file=sys.stderr)
    return 1


if __name__ == "__main__":
    code = main()
    sys.stderr.flush()
    os._exit(code)  # MLflow's threads need not be waited for
