"""The command line as a person can type it again: arguments flow in, a line flows out."""

import re
import runpy
import shlex
import shutil
import sys
from pathlib import Path

COMMAND = re.compile(r"\S*\bpython[\d.]* -m pipeline\b.*")
CARRIED = ("outputs", "budget")
"""What the command of a next run takes over from the one before: where it is written, and how large it is."""
SINGLE = ("sweep", "stages", "plan")
"""What was typed for one run alone."""


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


def split_command(sentence: str) -> tuple[str, str]:
    """Return a sentence and the command of this program that it ends with, if it does."""
    found = COMMAND.search(sentence)
    return (sentence[: found.start()].rstrip(), found.group()) if found else (sentence, "")


def complete(sentence: str, typed: str, folder: str) -> str:
    """Return a stage's sentence with the run's folder for FOLDER, and a command at its end as it can be typed.

    In place of ARGUMENTS stands all that was `typed` to start the run but what the command sets anew; without it, what
    was typed of `CARRIED`.
    """
    told, command = split_command(sentence)
    told = told.replace("FOLDER", folder)
    if not command:
        return told
    begun, _, given = typed.partition("-m pipeline")
    words = shlex.split(command)[3:]
    own = {word.partition("=")[0] for word in words}
    kept = [each for each in shlex.split(given) if each.partition("=")[0] not in (*own, *SINGLE)]
    carried = [each for each in kept if each.partition("=")[0] in CARRIED]
    filled = [
        override(key, value.replace("FOLDER", folder)) if "FOLDER" in value else shlex.quote(word)
        for word in words
        if word != "ARGUMENTS"
        for key, _, value in [word.partition("=")]
    ]
    given = shlex.join(kept if "ARGUMENTS" in words else carried)
    return " ".join(filter(None, (told, f"{begun}-m pipeline", given, *filled)))


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
