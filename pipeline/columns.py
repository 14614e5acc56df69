"""Looks at a file that others wrote: ``python -m pipeline.columns FILE``.

What its columns hold and the command line that would read them flow out; nothing is written. What is said of them is
known to the function that ``conf/columns.yaml`` names.
"""

import argparse
import sys
from importlib import import_module
from pathlib import Path

import yaml

from pipeline.errors import ConfigError, PipelineError
from pipeline.files import CONFIG_FOLDER
from pipeline.inputs import InputPath
from pipeline.terminal import complain, open_console, say


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; return the exit code."""
    parser = argparse.ArgumentParser(
        prog="python -m pipeline.columns",
        description="Tell what a measured file holds, and print the command with the map of its columns.",
    )
    parser.add_argument("file", metavar="FILE", help="a table (.parquet, .csv, .mat, ...), or a folder with one")
    file = parser.parse_args(arguments).file
    try:
        if not Path(file).exists():
            raise ConfigError(f"expected the path of a file, got {file!r}, which is not in {Path.cwd()}")
        module, _, name = yaml.safe_load((CONFIG_FOLDER / "columns.yaml").read_text())["describe"].rpartition(".")
        lines: list[str] = getattr(import_module(module), name)(InputPath(file))
    except PipelineError as error:
        complain(str(error))
        return 2
    console = open_console(piped_width=200)
    for line in lines:
        say(line, console)
    return 0


if __name__ == "__main__":
    sys.exit(main())
