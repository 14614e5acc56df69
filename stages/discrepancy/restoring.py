"""Fits rebuilt from the values that a table keeps."""

from __future__ import annotations

import numpy as np
import pandas as pd

from stages.discrepancy.cell import Cell, Form
from stages.discrepancy.fitting import Model
from stages.signals.trajectories import Array


def restore(cell: Cell, steps: pd.DataFrame, step: int) -> tuple[Model, Array]:
    """Return a cell's model and values after a number of additions.

    Parameters
    ----------
    cell : Cell
        With any of the session's trials.
    steps : DataFrame
        Columns ``step channel muscle effect form parameter value``.
    step : int
        Effects added.
    """
    rows = steps[(steps["step"] == step) & (steps["channel"] == cell.channel) & (steps["muscle"] == cell.element)]
    constants = rows[rows["effect"] == ""].set_index("parameter")["value"]
    values = [float(constants[each.name]) for each in cell.constants]
    forms: list[Form] = []
    chosen = rows[rows["effect"] != ""]
    for (effect, form), given in chosen.groupby(["effect", "form"], sort=False):
        found = find_form(cell, str(effect), str(form))
        by_name = given.set_index("parameter")["value"]
        forms.append(found)
        values += [float(by_name[each.name]) for each in found.parameters]
    return Model(cell, tuple(forms)), np.array(values)


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
