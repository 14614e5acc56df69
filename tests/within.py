"""Command lines without a new process for each: run in this one, or in one forked off it, which need import nothing.

What runs is what ``python -m MODULE`` runs, from its arguments to its exit code. In this process, whatever a command
changes is put back afterwards. A forked one can be killed, limited and sent signals. Where the start itself is at
stake, or other code than this, a command is started in full instead.
"""

import logging
import os
import pickle
import runpy
import signal
import subprocess
import sys
import tempfile
import traceback
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from functools import partial
from multiprocessing import resource_tracker
from pathlib import Path
from unittest.mock import patch

from hydra._internal.core_plugins.file_config_source import FileConfigSource
from hydra._internal.hydra import Hydra
from hydra.core.config_store import ConfigStore
from hydra.core.global_hydra import GlobalHydra
from hydra.core.hydra_config import HydraConfig
from hydra.core.plugins import Plugins
from hydra.core.singleton import Singleton
from hydra.plugins.config_source import ConfigResult

import pipeline.__main__
import pipeline.review.__main__
from pipeline import ledger
from pipeline.interruption import WORDS

MAINS = {"pipeline": pipeline.__main__.main, "pipeline.review": pipeline.review.__main__.main}
MOST_HANDLES = 1024
_LOADED: dict[tuple, bytes] = {}

Plugins.instance()  # stores options of config groups when it is first asked for


def run_within(line: Sequence[str], environment: Mapping[str, str], folder: Path) -> subprocess.CompletedProcess[str]:
    """Run ``PYTHON -m MODULE ...`` here; return what `subprocess.run` would."""
    with tempfile.TemporaryFile("w+") as output, tempfile.TemporaryFile("w+") as errors:
        with _put_back(), _printing_to(output, errors), _without_what_only_takes_time():
            _enter(line, environment, folder)
            code = _exit_code(MAINS[line[2]])
        output.seek(0)
        errors.seek(0)
        return subprocess.CompletedProcess(line, code, output.read(), errors.read())


def start_forked(
    line: Sequence[str], environment: Mapping[str, str], folder: Path, before: Callable[[], object] | None
) -> subprocess.Popen[str]:
    """Start ``PYTHON -m MODULE ...`` in a process forked off this one, which calls `before` first."""
    return subprocess.Popen(
        line,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        restore_signals=False,
        preexec_fn=partial(_live, line, environment, folder, before),
    )


def _live(line: Sequence[str], environment: Mapping[str, str], folder: Path, before: Callable[[], object] | None):
    """Be the process of a command line, to the end: nothing is executed in its place."""
    with _without_what_only_takes_time():
        if before is not None:
            before()
        os.closerange(3, MOST_HANDLES)  # by which Popen knows that the process lives
        resource_tracker._resource_tracker._fd = None  # that of the parent
        with open(1, "w", closefd=False) as sys.stdout, open(2, "w", buffering=1, closefd=False) as sys.stderr:
            _enter(line, environment, folder)
            sys.modules.pop(f"{line[2]}.__main__")
            sys.path[:0] = filter(None, os.environ.get("PYTHONPATH", "").split(os.pathsep))
            code = _exit_code(partial(runpy.run_module, line[2], run_name="__main__", alter_sys=True))
    os._exit(code)


def _enter(line: Sequence[str], environment: Mapping[str, str], folder: Path) -> None:
    os.chdir(folder)
    os.environ.clear()
    os.environ.update(environment)
    sys.argv = list(line[2:])
    ledger._LOOKED_AT.clear()


def _exit_code(main: Callable[[], int | None]) -> int:
    try:
        return main() or 0
    except SystemExit as left:
        return left.code if isinstance(left.code, int) else int(left.code is not None)
    except Exception:
        traceback.print_exc()
        return 1


@contextmanager
def _without_what_only_takes_time() -> Iterator[None]:
    """Leave out that the disk is waited for, and that Hydra composes everything once to ask for its mode."""
    with patch.object(os, "fsync"), patch.object(Hydra, "get_mode", return_value=None):
        yield


def load_once(source: FileConfigSource, config_path: str, load=FileConfigSource.load_config) -> ConfigResult:
    """Return a copy of what a file of the configuration held when it was parsed, as long as it is the same file."""
    try:
        facts = os.stat(os.path.join(source.path, source._normalize_file_name(config_path)))
    except OSError:
        return load(source, config_path)
    key = (source.provider, source.path, config_path, facts.st_ino, facts.st_mtime_ns, facts.st_size)
    if key not in _LOADED:
        _LOADED[key] = pickle.dumps(load(source, config_path))
    return pickle.loads(_LOADED[key])


@contextmanager
def _printing_to(output, errors) -> Iterator[None]:
    """Have everything that is printed go to these files, also by processes that are started meanwhile."""
    with ExitStack() as stack:
        for name, handle, file in (("stdout", 1, output), ("stderr", 2, errors)):
            getattr(sys, name).flush()
            kept = os.dup(handle)
            stack.callback(os.close, kept)
            os.dup2(file.fileno(), handle)
            stack.callback(os.dup2, kept, handle)
            stream = stack.enter_context(open(handle, "w", closefd=False))
            stack.enter_context(patch.object(sys, name, stream))
        yield


@contextmanager
def _put_back() -> Iterator[None]:
    """Put back afterwards what a command changes of its process."""
    log = logging.getLogger("pamid")
    store, composing, config = ConfigStore.instance(), GlobalHydra.instance(), HydraConfig.instance()
    here, heard = Path.cwd(), {number: signal.getsignal(number) for number in WORDS}
    with (
        patch.dict(os.environ),
        patch.object(Singleton, "_instances", dict(Singleton._instances)),
        patch.object(store, "repo", _branch(store.repo)),
        patch.object(composing, "hydra", composing.hydra),
        patch.object(config, "cfg", config.cfg),
        patch.object(sys, "argv", sys.argv),
        patch.object(log, "propagate", log.propagate),
        patch.object(log, "level", log.level),
        patch.object(logging, "raiseExceptions", logging.raiseExceptions),
        warnings.catch_warnings(),
    ):
        try:
            yield
        finally:
            os.chdir(here)
            for number, handler in heard.items():
                signal.signal(number, handler)


def _branch(tree):
    """Copy what branches; the leaves stay the same."""
    return {name: _branch(each) for name, each in tree.items()} if isinstance(tree, dict) else tree
