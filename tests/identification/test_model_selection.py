"""Inputs and constants of the models by designed trials of the tiny budget that begin with a wrong one."""

from types import SimpleNamespace

import pandas as pd
import pytest

from stages.identification.model_selection import describe_selection, is_better
from tests.studies import read_stages, run_stage

CHAIN = ["bank", "subsampling", "hyperprior", "task", "hardware", "active_loop", "model_selection", "comparison"]
WRONG = (
    "experiment=designed",
    "active_loop.controls=[]",
    "model.inputs=[pressure,contraction,contraction_velocity,direction]",
)


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    """The tables of a designed study."""
    study, stages = read_stages(CHAIN, *WRONG)
    folder, tables = tmp_path_factory.mktemp("constants"), {}
    for name in CHAIN:
        tables.update(run_stage(study, stages[name], folder, tables))
    return tables


def test_the_models_with_assumed_constants_are_those_of_the_design(found):
    last = found["learning_curve"].query("trial == trial.max()")
    keys = ["tested_on", "muscle"]
    both = last.merge(found["selection_errors"], on=[*keys, "participant", "experiment"])
    assert len(both) == 2 * 4 == len(found["selection_errors"].query("muscle != 'mean'"))
    pd.testing.assert_series_equal(both["assumed"], both["error_rate"], check_names=False, rtol=1e-3)


def test_a_selection_without_less_error_is_not_advised(found):
    errors = found["selection_errors"]
    assert is_better(errors)
    assert not is_better(errors.assign(selected=errors["assumed"]))
    worse = errors["selected"].where(errors["tested_on"] != "task", 1.01 * errors["assumed"])
    assert not is_better(errors.assign(selected=worse))
    tables = found["selected_inputs"], found["selected_constants"], errors.assign(selected=worse)
    told = describe_selection(*tables, SimpleNamespace(gain=60.1), "the same trials", sure=True)
    assert told[0].startswith(
        "Keep the inputs and constants of the models as they were assumed. Others fit the designed"
    )


def test_what_is_tried_and_found_is_told_with_what_to_type(found):
    inputs, constants = (found[name] for name in ("selected_inputs", "selected_constants"))
    tried = found["models_tried"]
    best = tried.loc[tried["score"].idxmax()]
    selected = inputs.loc[inputs["selected"], "input"].to_list()
    assert [each for each in best["inputs"].split(",") if each in set(inputs["input"])] == selected
    assert inputs.query("assumed")["input"].to_list() == ["direction"]
    assert any(each.startswith("contraction_stop") for each in selected)
    assert constants["selected"].to_list() == [best[name] for name in constants["constant"]]
    assert best["score"] > tried["score"].iloc[0] + 3.0
    sentences = found["selection_findings"]["sentence"]
    assert sentences[0].startswith("The designed trials are evidence for other inputs or constants: also contraction_")
    assert f"'model.inputs=[{best['inputs']}]'" in found["selection_advice"]["sentence"][0]
