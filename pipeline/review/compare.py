"""Runs beside each other on the terminal and on a page: their folders flow in, text and a page flow out."""

from __future__ import annotations

import argparse
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd
from rich.console import Console

from pipeline.errors import PipelineError
from pipeline.files import hash_json
from pipeline.page import Block, Section, make_grid, make_rows, write_page
from pipeline.printing import format_range, print_frame
from pipeline.review.comparison import Comparison, choose_runs
from pipeline.review.curves import Curves, make_curves
from pipeline.terminal import say

COLUMNS_OF_A_TERMINAL = 6
LONGEST_FILE_NAME = 80
STRANGE = re.compile(r"[^\w.=+-]+")


def review(options: argparse.Namespace, console: Console) -> None:
    """Print how runs differ, and write a page of it, with their curves.

    Raises
    ------
    PipelineError
        When the runs cannot be found, or the page cannot be written.
    """
    names = options.runs
    found = Comparison(choose_runs(options.outputs, names), options.all)
    curves, complaints = make_curves(found.ledgers, found.nested, found.flat)
    for each in replace(found, most=COLUMNS_OF_A_TERMINAL).differences():
        title = f"{each.name}: {each.told}" if each.told else each.name
        if each.frame.empty:
            say(title, console)
        else:
            print_frame(title, each.frame, console, options.rows, "--rows")
    for told in complaints:
        say(told, console)
    joined = "_vs_".join(STRANGE.sub("-", each).strip("-") for each in names)
    file = f"compare-{joined if len(joined) <= LONGEST_FILE_NAME else hash_json(list(names))[:12]}.html"
    path = Path(options.html) if options.html else Path(options.outputs) / "reviews" / file
    if not path.name:
        raise PipelineError(f"cannot write {path}: Is a directory; name another file by --html PATH")
    part = "Everything is listed." if options.all else "What is the same in all runs is left out (--all lists it)."
    shown = [Section("Curves", _show_curves(curves, complaints))]
    for name, told, frame in found.differences():
        blocks: list[Block] = [("note", f"{_begin_upper(told)}.")] if told else []
        shown.append(Section(_begin_upper(name), blocks + ([] if frame.empty else [("grid", make_grid(frame))])))
    named = ", ".join(names)
    try:
        write_page(
            path,
            title=f"compare {named}",
            heading="Comparison",
            lead=f"{named}: {len(found.ledgers)} runs. {part}",
            status="",
            opening=[],
            sections=shown,
        )
    except OSError as error:
        raise PipelineError(f"cannot write {path}: {error.strerror}; name another file by --html PATH") from None
    say(f"page: {path}", console)


def _begin_upper(text: str) -> str:
    return text[:1].upper() + text[1:]


def _show_curves(curves: Sequence[Curves], complaints: Sequence[str]) -> list[Block]:
    from pipeline.review.drawing import draw_curves

    blocks: list[Block] = []
    for each in curves:
        blocks += [("heading", each.name), ("pictures", [draw_curves(each)]), ("grid", _list_lines(each))]
    blocks += [("note", f"{each}.") for each in complaints]
    note = "Runs that differ in seeds alone are repeats: together they are one line."
    return [("note", note), *blocks] if blocks else []


def _list_lines(curves: Curves) -> dict[str, Any]:
    rows = []
    for line in curves.lines:
        row = [line.label, format_range(line.points["n"]), len(line.runs)]
        for _, point in line.points.iloc[[0, -1]].iterrows():
            band = "" if pd.isna(point["half"]) else f" ± {point['half']:.2g}"
            row.append(f"{point['mean']:.4g}{band} at {point['x']:g}")
        rows.append(row)
    return make_rows(["line", "n at each point", "runs", f"first: {curves.y}", f"last: {curves.y}"], rows)
