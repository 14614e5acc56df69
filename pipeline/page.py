"""Pages that stand alone: a template and values flow in, one HTML text flows out that asks for nothing elsewhere."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any
from urllib.parse import quote

import jinja2
import pandas as pd

from pipeline.printing import format_value

PAGES = Path(__file__).parent / "pages"


def render(template: str, **values: Any) -> str:
    """Return a page.

    Parameters
    ----------
    template : str
        Name of a file in ``pipeline/pages``.
    **values
        What it shows.
    """
    return _environment().get_template(template).render(**values)


def read_templates() -> None:
    """Read all templates, which then this process, and those forked off it, need not read again."""
    for name in _environment().list_templates():
        _environment().get_template(name)


@cache
def _environment() -> jinja2.Environment:
    return jinja2.Environment(
        loader=jinja2.FileSystemLoader(PAGES),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )


def make_grid(
    frame: pd.DataFrame,
    units: Mapping[str, str] | None = None,
    meanings: Mapping[str, str] | None = None,
    links: Sequence[str] = (),
) -> dict[str, Any]:
    """Return a frame as the templates show it.

    Parameters
    ----------
    frame : DataFrame
        Short enough to be shown whole.
    units, meanings : mapping, optional
        Of columns that have one.
    links : sequence of str
        For each row where its first cell leads; empty for nowhere.
    """
    units, meanings = units or {}, meanings or {}
    names = [str(each) for each in frame.columns]
    numeric = [bool(pd.api.types.is_numeric_dtype(frame[each])) for each in frame.columns]
    return {
        "columns": [(name, units.get(name, "1"), meanings.get(name, "")) for name in names],
        "numeric": numeric,
        "cells": [[format_value(value) for value in row] for row in frame.itertuples(index=False)],
        "exact": [
            ["" if each != each or each is None else repr(float(each)) if number else None for each, number in pairs]
            for pairs in (zip(row, numeric, strict=True) for row in frame.itertuples(index=False))
        ],
        "links": list(links),
    }


def make_rows(heads: Sequence[str], rows: Iterable[Sequence[Any]]) -> dict[str, Any]:
    """Return rows of texts as the templates show a frame."""
    return make_grid(pd.DataFrame([list(each) for each in rows], columns=list(heads)))


def link_to(*parts: str) -> str:
    """Return the relative address of a file below the page's folder."""
    return "./" + "/".join(quote(each) for each in parts)
