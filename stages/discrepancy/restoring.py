"""Fits rebuilt from the values that a table keeps."""

from __future__ import annotations

import numpy as np
import pandas as pd

from stages.discrepancy.cell import Cell, Form
from stages.discrepancy.fitting import Model
from stages.signals.trajectories import Array


def restore(cell: Cell, steps: pd.DataFrame, step: int) -> tuple[Model, Array]:
    """Return a cell's model and values after a number of additions, its inputs corrected by what is known then.

    Parameters
    ----------
    cell : Cell
        With any of the session's trials.
    steps : DataFrame
        Columns ``step channel muscle effect form parameter value``.
    step : int
        Effects added.
    """
    now = steps[(steps["step"] == step) & (steps["muscle"] == cell.element)]
    rows = now[now["channel"] == cell.channel]
    upstream = now[(now["channel"] != cell.channel) & (now["effect"] != "")]
    cell = cell.correct([(effect, form, values) for effect, form, values in _group(upstream)])
    constants = rows[rows["effect"] == ""].set_index("parameter")["value"]
    values = [float(constants[each.name]) for each in cell.constants]
    forms: list[Form] = []
    for effect, form, by_name in _group(rows[rows["effect"] != ""]):
        found = find_form(cell, effect, form)
        forms.append(found)
        values += [by_name[each.name] for each in found.parameters]
    return Model(cell, tuple(forms)), np.array(values)


def _group(rows: pd.DataFrame) -> list[tuple[str, str, dict[str, float]]]:
    """Return each effect's name, form and parameters."""
    return [
        (str(effect), str(form), {str(n): float(v) for n, v in zip(given["parameter"], given["value"], strict=True)})
        for (effect, form), given in rows.groupby(["effect", "form"], sort=False)
    ]


def find_form(cell: Cell, name: str, form: str) -> Form:
    """Return one of the cell's forms.

    Raises
    ------
    ValueError
        When the cell offers none of that name.
    """
    for each in cell.forms:
        if (each.name, each.form) == (name, form):
            return each
    raise ValueError(f"{cell.channel} of {cell.element}: no effect {name} of form {form}")
