"""Consoles on standard output and standard error, whose reader may leave before the work is done."""

from __future__ import annotations

import io
import os
import sys
from typing import IO, TYPE_CHECKING, TextIO, cast

if TYPE_CHECKING:
    from rich.console import Console

PIPED_WIDTH = 160


def open_console(stderr: bool = False, piped_width: int = PIPED_WIDTH, quiet: bool = False) -> Console:
    """Return a console: as wide as the terminal, or `piped_width` columns where there is none; quiet, or not."""
    from rich.console import Console  # which --help needs not

    if quiet:
        return Console(file=io.StringIO(), quiet=True)
    stream = sys.stderr if stderr else sys.stdout
    if stream.isatty():
        return Console(stderr=stderr)
    return Console(file=cast(IO[str], Unread(stream)), stderr=stderr, width=piped_width)


def say(text: str, console: Console | None = None) -> None:
    """Print a text as it is, on standard output unless another console is given."""
    (console or open_console()).print(text, soft_wrap=True, highlight=False, markup=False)


def complain(text: str) -> None:
    """Print a text as it is, on standard error."""
    say(text, open_console(stderr=True))


class Unread(io.TextIOBase):
    """A stream that goes on when nobody reads it any more: a study outlives the pipe that it prints to."""

    def __init__(self, stream: TextIO):
        self.stream = stream

    def write(self, text: str) -> int:
        """Write, into nothing once the reader is gone."""
        try:
            self.stream.write(text)
            self.stream.flush()
        except BrokenPipeError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), self.stream.fileno())
        return len(text)
