"""While a command runs, a process of its own sends what it leaves in its folders; the command hardly notices.

Folders flow in; a line on the terminal flows out. MLflow is imported by that process alone, beside the run. At the end
the command waits for it no longer than the configuration says, then stops it, and says how the rest is sent.
"""

import json
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from pipeline.command import review_line
from pipeline.config import Tracking, read_tracking
from pipeline.files import read_end
from pipeline.ledger import Ledger
from pipeline.terminal import complain, say
from pipeline.tracking.destination import Destination, find_destination


@contextmanager
def following(outputs: str, tracking: Tracking | None) -> Iterator[Callable[[Path], None]]:
    """Yield what is to be called with each folder of a run or sweep that begins; what it leaves is sent meanwhile.

    Without tracking, nothing is.
    """
    if tracking is None:
        yield lambda folder: None
        return
    destination = find_destination(outputs, tracking)
    told: list[Path] = []
    options = {**tracking.model_dump(), "outputs": str(destination.outputs), "uri": destination.uri}
    with tempfile.TemporaryFile() as errors:
        process = subprocess.Popen(
            [sys.executable, "-m", "pipeline.tracking", json.dumps(options)],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=errors,
            start_new_session=True,  # Ctrl-C is for the run, whose end is sent yet
        )

        def follow(folder: Path) -> None:
            destination.mark(folder)
            told.append(folder)
            with suppress(OSError):
                assert process.stdin
                process.stdin.write(f"{folder}\n".encode())
                process.stdin.flush()

        try:
            yield follow
        finally:
            late = _wait(process, tracking.within_s)
            reason = late or (read_end(errors, 4000).strip().splitlines() or ["no reason was given"])[-1]
    if process.returncode == 0:
        say(f"sent to MLflow; to look at it: {destination.look()}")
    else:
        again = _export_line(destination, told)
        complain(f"not sent to MLflow: {reason}; the next command with tracking=mlflow sends it, or type: {again}")


def _wait(process: subprocess.Popen[bytes], within_s: float) -> str | None:
    """Let the process end, no longer than so many seconds; return why it was stopped, if it was."""
    try:
        process.communicate(timeout=within_s)
    except subprocess.TimeoutExpired:
        return f"it takes longer than tracking.within_s={within_s:g} s"
    finally:
        process.kill()
        process.wait()
    return None


def _export_line(destination: Destination, folders: Sequence[Path]) -> str:
    """Return the command that sends folders of an outputs folder."""
    usual = read_tracking("mlflow", {})
    options = [] if destination.is_own else ["--uri", destination.uri]
    options += [] if destination.experiment == usual.experiment else ["--experiment", destination.experiment]
    names = [Ledger(each).name for each in folders]
    return review_line(str(destination.outputs), "export", "--to", "mlflow", *options, *names)
