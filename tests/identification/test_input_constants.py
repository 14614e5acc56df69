"""Constants of the models' memory by designed trials of the tiny budget that begin with wrong ones."""

import pandas as pd
import pytest

from tests.studies import assert_refused, read_stages, run_stage

CHAIN = ["bank", "subsampling", "hyperprior", "task", "hardware", "active_loop", "input_constants", "comparison"]
WRONG = ("experiment=designed", "active_loop.controls=[]", "model.constants.highpass_s=0.1")


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
    both = last.merge(found["constants_errors"], on=[*keys, "participant", "experiment"])
    assert len(both) == 2 * 4 == len(found["constants_errors"].query("muscle != 'mean'"))
    pd.testing.assert_series_equal(both["assumed"], both["error_rate"], check_names=False, rtol=1e-3)


def test_what_is_tried_and_found_is_told_with_what_to_type(found):
    constants = found["input_constants"].set_index("constant")
    tried = found["constants_tried"]
    best = tried.loc[tried["score"].idxmax()]
    assert constants["assumed"].to_dict() == {"stop_width": 0.015, "highpass_s": 0.1}
    assert constants["identified"].to_dict() == {name: best[name] for name in constants.index}
    assert constants.loc["highpass_s", "octaves"] > 1.0
    assert best["score"] > tried["score"].iloc[0] + 3.0
    sentences = found["constants_findings"]["sentence"]
    assert "highpass_s" in sentences[0]
    assert "instead of 0.1" in sentences[0]
    assert f"model.constants.highpass_s={best['highpass_s']:.4g}" in sentences[1]


def test_models_without_a_constant_are_refused():
    assert_refused(
        CHAIN,
        "model.inputs: expected one with a constant to identify, got pressure, contraction, contraction_velocity; set "
        "model=memory, or leave input_constants out of workflow.stages",
        "experiment=designed",
        "model=paper",
        "hyperprior=default",
    )
