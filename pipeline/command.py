"""The command line as a person can type it again: arguments flow in, a line flows out."""

import re
import runpy
import shlex
import shutil
import sys
from pathlib import Path


def run_pipeline() -> None:
    """Run ``python -m pipeline``."""
    runpy.run_module("pipeline", run_name="__main__", alter_sys=True)


def run_review() -> None:
    """Run ``python -m pipeline.review``."""
    runpy.run_module("pipeline.review", run_name="__main__", alter_sys=True)


def command_line(arguments: list[str]) -> str:
    """Return the command that starts a run with these arguments, with the Python that runs now."""
    return shlex.join([python_name(), "-m", "pipeline", *arguments])


def override(key: str, value: str) -> str:
    """Return ``key=value`` as it is typed, quoted for Hydra and the shell where the value needs it."""
    plain = re.fullmatch(r"[\w./:+-]+", value)
    quoted = "'{}'".format(value.replace("'", "\\'"))
    return shlex.quote(f"{key}={value if plain else quoted}")


def review_line(outputs: str, *arguments: str) -> str:
    """Return the command that looks at the runs of an outputs folder."""
    place = [] if outputs == "outputs" else ["--outputs", outputs]
    return shlex.join([python_name(), "-m", "pipeline.review", *place, *arguments])


def python_name() -> str:
    """Return the shortest name under which the running Python can be typed."""
    for name in ("python", "python3"):
        found = shutil.which(name)
        if found and Path(found).absolute() == Path(sys.executable).absolute():
            return name
    executable = Path(sys.executable).absolute()
    return str(executable.relative_to(Path.cwd()) if executable.is_relative_to(Path.cwd()) else executable)
