"""The command line: arguments as typed flow in; options and overrides, or a line to type again, flow out.

The options are Hydra's, which reads them again where it shows help or the configuration.
"""

import re
import runpy
import shlex
import shutil
import sys
from argparse import ArgumentParser, Namespace
from collections.abc import Sequence
from pathlib import Path
from typing import NoReturn

from pipeline.errors import ConfigError

FLAGS = ("--help -h", "--hydra-help", "--resolve", "--run -r", "--multirun -m", "--shell-completion -sc")
WITH_VALUE = ("--package -p", "--config-path -cp", "--config-name -cn", "--config-dir -cd")
INFORMATION = ("all", "config", "defaults", "defaults-tree", "plugins", "searchpath")
COMMAND = re.compile(r"\S*\bpython[\d.]* -m pipeline\b.*")
CARRIED = ("outputs", "budget", "workers")
"""What the command of a next run takes over from the one before: place, size and cores."""
SINGLE = ("sweep", "stages", "plan")
"""What was typed for one run alone."""


def run_pipeline() -> None:
    """Run ``python -m pipeline``."""
    runpy.run_module("pipeline", run_name="__main__", alter_sys=True)


def run_review() -> None:
    """Run ``python -m pipeline.review``."""
    runpy.run_module("pipeline.review", run_name="__main__", alter_sys=True)


class _Parser(ArgumentParser):
    def error(self, message: str) -> NoReturn:
        raise ConfigError(f"{message}; python -m pipeline --hydra-help shows the options")


def read_options(arguments: Sequence[str]) -> Namespace:
    """Return the options of a command line, and its ``overrides``, which may stand among them."""
    parser = _Parser(add_help=False)
    for names in FLAGS:
        parser.add_argument(*names.split(), action="store_true")
    for names in WITH_VALUE:
        parser.add_argument(*names.split())
    parser.add_argument("--cfg", "-c", choices=("job", "hydra", "all"))
    parser.add_argument("--info", "-i", nargs="?", const="all", choices=INFORMATION)
    parser.add_argument("overrides", nargs="*")
    return parser.parse_intermixed_args(list(arguments))


def put_options_first(arguments: Sequence[str]) -> list[str]:
    """Return the command line with its options before the overrides, as Hydra reads it."""
    overrides = read_options(arguments).overrides
    options = list(arguments)
    for each in overrides:
        options.remove(each)
    return [*options, *overrides]


def command_line(arguments: list[str]) -> str:
    """Return the command that starts a run with these arguments, with the Python that runs now."""
    return shlex.join([python_name(), "-m", "pipeline", *arguments])


def override(key: str, value: str) -> str:
    """Return ``key=value`` as it is typed, quoted for Hydra and the shell where the value needs it."""
    plain = re.fullmatch(r"[\w./:+-]+", value, re.ASCII)
    quoted = "'{}'".format(value.replace("'", "\\'"))
    return shlex.quote(f"{key}={value if plain else quoted}")


def split_command(sentence: str) -> tuple[str, str]:
    """Return a sentence and the command of this program that it ends with, if it does."""
    found = COMMAND.search(sentence)
    return (sentence[: found.start()].rstrip(), found.group()) if found else (sentence, "")


def complete(sentence: str, typed: str, folder: str) -> str:
    """Return a stage's sentence with the run's folder for FOLDER, and a command at its end as it can be typed.

    In place of ARGUMENTS stands all that was `typed` to start the run but what the command sets anew and what lies
    below it; without it, what was typed of `CARRIED`.
    """
    told, command = split_command(sentence)
    told = told.replace("FOLDER", folder)
    if not command:
        return told
    begun, _, given = typed.partition("-m pipeline")
    words = shlex.split(command)[3:]
    own = (*(word.partition("=")[0] for word in words), *SINGLE)
    keys = {each: each.partition("=")[0].lstrip("+~") for each in shlex.split(given)}
    kept = [each for each, key in keys.items() if key not in own and not key.startswith(tuple(f"{it}." for it in own))]
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
