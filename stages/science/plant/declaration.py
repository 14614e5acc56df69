"""How a section of the configuration is declared: every key required, none unknown, finite numbers."""

import difflib
import importlib
import pkgutil
from collections.abc import Iterable
from functools import cache

from pydantic import BaseModel, ConfigDict


class Declared(BaseModel):
    """A frozen section whose values stand in YAML or nowhere."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


@cache
def list_modules(package: str) -> tuple[str, ...]:
    """Return the names of the modules of a package, sorted."""
    return tuple(sorted(module.name for module in pkgutil.iter_modules(importlib.import_module(package).__path__)))


def nearest(name: str, known: Iterable[str]) -> str:
    """Return a hint: the nearest known name, or all of them."""
    names = sorted(known)
    close = difflib.get_close_matches(name, names, n=1)
    return f"did you mean '{close[0]}'?" if close else f"known are {', '.join(names) or 'none'}"
