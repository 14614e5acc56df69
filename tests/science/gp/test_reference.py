import json
from pathlib import Path

import pytest

from tests.reference_parity import TOLERANCES, check

REFERENCE = Path(__file__).resolve().parents[4] / "shared" / "reference"


def reference(name):
    if not (REFERENCE / name).is_file():
        pytest.skip(f"the reference numbers {REFERENCE / name} are not on this machine")
    return json.loads((REFERENCE / name).read_text())


def over(found):
    return {quantity: worst for quantity, worst in found.items() if worst[0] > 1.0}


def test_all_cases_and_loops_agree():
    found = check(reference("cases.json"), reference("loop.json"))
    assert set(found) == set(TOLERANCES)
    assert over(found) == {}


def shift(values, index, by):
    values[index] += by


ALTERED = {
    "": lambda case: None,
    "log posterior": lambda case: shift(case["fixed"], "neg_log_posterior", 1e-6),
    "gradient": lambda case: shift(case["fixed_far"]["grad_neg_log_likelihood"], 1, 1e-2),
    "hessian": lambda case: shift(case["map"]["hess_neg_log_posterior"][0], 0, 1e-2),
    "variances": lambda case: shift(case["fixed"]["f_var"], 7, 1e-5),
    "variances beside a missing one": lambda case: shift(case["fixed"]["f_var"], 0, float("nan")),
    "marginal variances": lambda case: shift(case["map_polished"]["mgp_y_var"], 3, 1e-5),
    "marginal variances given sigma": lambda case: shift(case["fixed"]["given_sigma"]["mgp_f_var"], 0, 1e-5),
    "argmax": lambda case: shift(case["map_polished"], "argmax_y_over_y_index0", 1),
    "map search": lambda case: shift(case["map"], "neg_log_posterior", -1e-3),
}


@pytest.mark.parametrize("quantity", ALTERED)
def test_an_altered_or_missing_number_is_found_and_nothing_else(quantity):
    case = reference("cases.json")["cases"][2]
    ALTERED[quantity](case)
    found = over(check({"cases": [case]}))
    assert bool(found) == bool(quantity)
    assert not quantity or quantity.removesuffix(" beside a missing one") in found


def test_an_altered_pick_is_found():
    loop = reference("loop.json")
    loop["runs"] = [run for run in loop["runs"] if run["mode"] == "y_over_y"][:2]
    for run in loop["runs"]:
        run["chosen_index0"], run["rmse_per_iter"] = run["chosen_index0"][:6], run["rmse_per_iter"][:7]
    loop["runs"][0]["chosen_index0"][4] += 1
    assert "loop picks" in over(check(loop=loop))
