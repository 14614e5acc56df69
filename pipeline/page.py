"""Pages that stand alone: sections of blocks flow in, one HTML file flows out that asks for nothing elsewhere.

A block is a pair: its kind and what it shows. Kinds: ``heading``, ``note``, ``text`` and ``command`` (a str),
``status`` (a word, and what it is about), ``prose`` and ``finding`` (sentences), ``facts`` (pairs of texts), ``links``
(pairs of text and address), ``grid``, ``sortable`` and ``meanings`` (from `make_grid`), ``pictures`` (of `Picture`),
and what holds blocks: ``failure``, ``beside`` (a pair of lists) and ``details`` (from `make_details`).
"""

from __future__ import annotations

import base64
import re
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import pandas as pd

from pipeline.command import split_command
from pipeline.files import write_text
from pipeline.printing import add_unit, format_value, is_numeric

if TYPE_CHECKING:
    from jinja2 import Environment

PAGES = Path(__file__).parent / "pages"
WIDE = 1100
"""Pixels of a picture's width, at 150 to the inch, beyond which a phone shows it in a frame to scroll."""

Block = tuple[str, Any]


class Picture(NamedTuple):
    """A figure on a page, its bytes empty where it is not shown, and what it shows and what its marks are."""

    png: bytes
    caption: str

    @property
    def is_wide(self) -> bool:
        """Whether its letters would be too small on a phone that shows it whole."""
        return int.from_bytes(self.png[16:20]) > WIDE


class Section(NamedTuple):
    """A part of a page that the head of the page leads to."""

    title: str
    blocks: Sequence[Block]

    @property
    def anchor(self) -> str:
        """By which the page's head leads to it."""
        return re.sub(r"[^a-z0-9_]+", "-", self.title.lower())


def write_page(
    path: Path, title: str, heading: str, lead: str, status: str, opening: Sequence[Block], sections: Sequence[Section]
) -> None:
    """Write a page: the browser's tab has the `title`, the `lead` is the line below the heading.

    The status is marked as good if it is ``done``, and empty for none; sections without blocks are left out.
    """
    template = _environment().get_template("page.html.j2")
    shown = [each for each in sections if each.blocks]
    page = template.render(title=title, heading=heading, lead=lead, status=status, opening=opening, sections=shown)
    write_text(path, page)


def read_templates() -> None:
    """Read all templates, which then this process, and those forked off it, need not read again."""
    for name in _environment().list_templates():
        _environment().get_template(name)


@cache
def _environment() -> Environment:
    import jinja2  # which commands that write no page need not

    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(PAGES),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {
        "shown": format_value,
        "split_command": split_command,
        "with_unit": add_unit,
        "unbroken": lambda text: text.replace(" %", "\N{NO-BREAK SPACE}%"),
        "exact": lambda value: "" if value is None or value != value else repr(float(value)),
        "base64": lambda png: base64.b64encode(png).decode(),
    }
    return environment


def make_grid(
    frame: pd.DataFrame,
    units: Mapping[str, str] | None = None,
    meanings: Mapping[str, str] | None = None,
    links: Sequence[str] = (),
) -> dict[str, Any]:
    """Return a frame, short enough to be shown whole, as the templates show it.

    Units and meanings are those of columns that have one; links say for each row where its first cell leads, if not "".
    """
    units, meanings = units or {}, meanings or {}
    names = [str(each) for each in frame.columns]
    return {
        "columns": [(name, units.get(name, "1"), meanings.get(name, "")) for name in names],
        "numeric": [is_numeric(frame[each]) for each in frame.columns],
        "rows": list(frame.itertuples(index=False)),
        "links": list(links),
    }


def list_sentences(frame: pd.DataFrame) -> list[str]:
    """Return the sentences that a frame of prose holds."""
    return [format_value(each) for each in frame.iloc[:, 0]]


def make_details(summary: str, blocks: Sequence[Block], is_open: bool = False) -> Block:
    """Return blocks that a page shows once somebody asks for them, or at once."""
    return "details", {"summary": summary, "blocks": blocks, "open": is_open}


def show_traceback(summary: str, traceback: str, is_open: bool) -> list[Block]:
    """Return a traceback, if there is one, as what a page shows at once or once somebody asks for it."""
    return [make_details(summary, [("text", traceback)], is_open)] if traceback else []


def make_rows(heads: Sequence[str], rows: Iterable[Sequence[Any]]) -> dict[str, Any]:
    """Return rows of texts as the templates show a frame."""
    return make_grid(pd.DataFrame([list(each) for each in rows], columns=list(heads)))
