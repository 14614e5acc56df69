"""Searches as the workflow makes them, with the stated settings, in outputs of whole records."""

import json

import numpy as np
import yaml

from stages.science.discrepancy.fitted_channel import prepare
from stages.science.discrepancy.search import search
from stages.science.discrepancy.settings import DescriptionSettings, DiscrepancySettings
from tests.science.plant.machines import CONF

STATED = yaml.safe_load((CONF / "discrepancy" / "default.yaml").read_text())
DISCREPANCY = DiscrepancySettings(**STATED)
SETTINGS = DISCREPANCY.search
DESCRIPTION = DescriptionSettings(**yaml.safe_load((CONF / "explain_remainder" / "default.yaml").read_text()))


def look(output, seed=0):
    """Return what the search finds in an output, and the names."""
    found = search([prepare(output)], SETTINGS, np.random.default_rng(seed))
    return found, [each.name for each in found.named]


def read_values(state):
    """Return the fitted constants, and the parameters of each effect by its name."""
    constants, effects = state.current.fit.model.name_values(state.current.fit.values)
    return constants, {form.name: values for form, values in effects}


def run_records(pamid, path, *overrides):
    """Run the workflow on records; return what it prints in one line, and the verdict."""
    given = ("workflow=discrepancy", "measurement=records", f"measured={path}", "columns.time_s=t", "figures=[]")
    told = pamid(*given, *overrides)
    assert told.returncode == 0, told.stderr
    return " ".join(told.stdout.split()), json.loads((pamid.runs[-1] / "verdict.json").read_text())
