"""A utility of the user's own: it chooses as its formula says, names its arm, counts for freshness, or is refused."""

import importlib
import sys

import numpy as np
import pandas as pd
import pytest

from pipeline.errors import ConfigError
from pipeline.sources import hash_sources, list_imported_by_name
from stages.science.gp.marginal import condition
from stages.science.gp.utility_names import find_utility
from tests.science.gp.data import make_data, make_prior
from tests.studies import PickledContext, read_stages, run_stage

CHAIN = ["bank", "subsampling", "hyperprior", "hardware", "active_loop"]
SOURCE = """
from chosen_here.factor import FACTOR

NOTHING = 3


def spread(terms):
    return FACTOR * terms.variance


def y_y(terms):
    return terms.variance


def single(terms):
    return 1.0


def undefined(terms):
    return terms.variance * float("nan")


def broken(terms):
    raise KeyError("abc")


def small_only(terms):
    return terms.variance if len(terms.variance) == 3 else terms.variance[1:]
"""
OWN = "{_target_: chosen_here.choices.spread}"


@pytest.fixture
def package(tmp_path, monkeypatch):
    """A package of the user's own outside the project."""
    folder = tmp_path / "chosen_here"
    folder.mkdir()
    for name, text in (("__init__", ""), ("choices", SOURCE), ("factor", "FACTOR = 4.0\n")):
        (folder / f"{name}.py").write_text(text)
    monkeypatch.syspath_prepend(str(tmp_path))
    importlib.invalidate_caches()
    yield folder
    for name in [each for each in sys.modules if each.split(".")[0] == "chosen_here"]:
        del sys.modules[name]


def test_it_chooses_trajectories_and_samples_as_its_formula_says_under_its_own_name(package, tmp_path):
    """Four times the variance ranks as the variance does."""
    told = {}
    for own, name in ((OWN, "spread"), ("variance", "variance")):
        overrides = f"active_loop.utility={own}", f"active_loop.subsample_utility={own}", "active_loop.trials=2"
        study, stages = read_stages(CHAIN, "active_loop=paper", "active_loop.controls=[]", "~task", *overrides)
        tables = {}
        for stage in CHAIN:
            tables.update(run_stage(study, stages[stage], tmp_path / name, tables, context=PickledContext))
        assert list(tables["trials"]["arm"].unique()) == [name]
        told[name] = {table: tables[table].drop(columns="arm") for table in ("trials", "points")}
    pd.testing.assert_frame_equal(told["spread"]["points"], told["variance"]["points"])
    ours, theirs = (told[name]["trials"] for name in ("spread", "variance"))
    assert list(ours["trajectory"]) == list(theirs["trajectory"])
    np.testing.assert_allclose(ours["utility"], 4.0 * theirs["utility"], rtol=1e-12)


def test_its_module_and_what_that_imports_count_for_freshness(package):
    study, stages = read_stages(CHAIN, "active_loop=paper", f"active_loop.controls=[random,{OWN}]", "~task")
    modules = list(list_imported_by_name(study.slice(stages["active_loop"])))
    assert "chosen_here.choices" in modules
    assert {"chosen_here/choices.py", "chosen_here/factor.py"} <= set(hash_sources("stages", modules))


@pytest.mark.parametrize(
    ("target", "told"),
    [
        ("nowhere_at_all.spread", "cannot import nowhere_at_all of nowhere_at_all.spread (ModuleNotFoundError: "),
        ("chosen_here.choices.sprad", "chosen_here.choices has no sprad; did you mean spread?"),
        ("chosen_here.choices.NOTHING", "chosen_here.choices.NOTHING: expected a function of PredictiveTerms, got a "),
        ("chosen_here.choices.y_y", "chosen_here.choices.y_y has the name of a utility that there is; rename"),
        ("chosen_here.choices.single", "chosen_here.choices.single: expected a score for each of 3 points, shape (3,)"),
        ("chosen_here.choices.undefined", "chosen_here.choices.undefined: expected finite scores, got nan at variance"),
        ("chosen_here.choices.broken", "chosen_here.choices.broken: expected scores, but it raises KeyError: 'abc'"),
        ("spread", "expected the dotted name of a function, as package.module.function, got 'spread'"),
    ],
)
@pytest.mark.parametrize("key", ["utility", "subsample_utility", "controls"])
def test_what_is_no_utility_is_refused_in_a_line_before_anything_is_measured(key, target, told, package):
    value, place = f"{{_target_: {target}}}", f"active_loop.{key}"
    if key == "controls":
        value, place = f"[random,{value}]", f"{place}.1"
    with pytest.raises(ConfigError) as refusal:
        read_stages(CHAIN, "active_loop=paper", "~task", f"active_loop.{key}={value}")
    assert str(refusal.value).startswith(f"{place}._target_: {told}")
    assert "\n" not in str(refusal.value)


def test_two_functions_of_one_name_and_further_keys_are_refused(package):
    (package / "other.py").write_text(SOURCE)
    for value, told in (
        (
            f"[{OWN},{{_target_: chosen_here.other.spread}}]",
            "arms are called by their functions, of which two are spread",
        ),
        (f"[{OWN},{OWN}]", "active_loop.controls=[{_target_: chosen_here.choices.spread}]"),
        (
            "[{_target_: chosen_here.choices.spread,factor: 2.0}]",
            "expected {_target_: package.module.function} and no other",
        ),
    ):
        with pytest.raises(ConfigError) as refusal:
            read_stages(CHAIN, "active_loop=paper", "~task", f"active_loop.controls={value}")
        assert told in str(refusal.value)


def test_scores_are_checked_whenever_they_are_asked_for(package, generator):
    model = condition(*make_data(generator, 8), make_prior().mean, make_prior())
    points = generator.standard_normal((5, 3))
    found = model.utility(points, "chosen_here.choices.spread")
    np.testing.assert_allclose(found, 4.0 * model.predict(points)[1], rtol=1e-9)
    with pytest.raises(ValueError, match=r"chosen_here.choices.small_only: expected a score for each of 5 points"):
        model.utility(points, "chosen_here.choices.small_only")
    with pytest.raises(ValueError, match="utility: expected one of y_y, "):
        find_utility("spread")
