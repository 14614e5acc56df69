"""The mistakes a person can make or meet, each a message for one terminal line.

A message says what was expected, what was found, and what to do or type next. Anything else that is raised is a fault
of the code: the runner puts its traceback into the run's log.
"""

from collections.abc import Iterable
from difflib import get_close_matches

MOST_OFFERED = 40
"""Names that a suggestion lists."""


class PipelineError(Exception):
    """A problem that its message explains completely; the terminal shows no traceback for it."""


class ConfigError(PipelineError):
    """The composed configuration is not one that this workflow can run."""


class TableError(PipelineError):
    """A table does not keep its contract, or its file cannot be read or written."""


class InputError(PipelineError):
    """A file that a person brought does not hold what it should."""


class TakenError(PipelineError):
    """Another process has the folder of this job at work."""


class WiringError(PipelineError):
    """The stages of a workflow do not fit together."""


def join_lines(text: str, most: int = 2) -> str:
    """Return the first lines of a text that say anything, as one."""
    return "; ".join([line.strip() for line in text.splitlines() if line.strip()][:most])


def suggest(name: str, known: Iterable[str], today: str | None = None) -> str:
    """Return a phrase that offers the nearest of the known names, or lists them all.

    `today` is what the name is called now, if it was renamed: ``"it is called 'x' today"``. Otherwise the phrase is
    ``"did you mean 'x'?"`` or ``"choose from: a, b"``.
    """
    if today is not None:
        return f"it is called '{today}' today"
    names = sorted(set(known))
    nearest = get_close_matches(name, names, n=1)
    if nearest:
        return f"did you mean '{nearest[0]}'?"
    more = f", and {len(names) - MOST_OFFERED} more" if len(names) > MOST_OFFERED else ""
    return f"choose from: {', '.join(names[:MOST_OFFERED])}{more}" if names else "nothing can be set here"
