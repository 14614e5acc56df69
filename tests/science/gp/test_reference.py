import json
from pathlib import Path

import pytest

from tests.reference_parity import TOLERANCES, main

ROOT = Path(__file__).resolve().parents[3]
REFERENCE = ROOT.parent / "shared" / "reference"


def reference(name):
    if not (REFERENCE / name).is_file():
        pytest.skip(f"the reference numbers {REFERENCE / name} are not on this machine")
    return REFERENCE / name


@pytest.fixture
def check(tmp_path, capsys):
    """Check a file of cases or loops, or of anything; return the exit code, what was printed and its path."""

    def run(what, text):
        file = tmp_path / "told.json"
        if text is not None:
            file.write_text(text)
        return main([what, str(file)]), capsys.readouterr(), file

    return run


def test_all_cases_and_loops_agree(capsys):
    assert main(["--cases", str(reference("cases.json")), "--loop", str(reference("loop.json"))]) == 0
    printed = capsys.readouterr()
    assert printed.err == ""
    assert "OVER" not in printed.out
    for quantity in TOLERANCES:
        assert f"\n{quantity}  " in f"\n{printed.out}"


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
def test_an_altered_or_missing_number_is_found_and_nothing_else(quantity, check):
    case = json.loads(reference("cases.json").read_text())["cases"][2]
    ALTERED[quantity](case)
    code, printed, _ = check("--cases", json.dumps({"cases": [case]}))
    over = [line for line in printed.out.splitlines() if " OVER " in line]
    assert code == bool(quantity) == bool(over)
    assert not quantity or any(line.startswith(f"{quantity.split(' beside')[0]}  ") for line in over)


def test_an_altered_pick_is_found(check):
    loop = json.loads(reference("loop.json").read_text())
    loop["runs"] = [run for run in loop["runs"] if run["mode"] == "y_over_y"][:2]
    for run in loop["runs"]:
        run["chosen_index0"], run["rmse_per_iter"] = run["chosen_index0"][:6], run["rmse_per_iter"][:7]
    loop["runs"][0]["chosen_index0"][4] += 1
    code, printed, _ = check("--loop", json.dumps(loop))
    assert code == 1
    assert "loop picks" in next(line for line in printed.out.splitlines() if " OVER " in line)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("{", "JSONDecodeError"),
        ("[]", "TypeError"),
        ('{"cases": []}', "ValueError: expected at least one case"),
        ('{"cases": [{"id": 0}], "runs": []}', "KeyError"),
        (None, "FileNotFoundError"),
    ],
)
@pytest.mark.parametrize("what", ["--cases", "--loop"])
def test_a_malformed_file_is_refused_in_one_line(what, text, told, check):
    code, printed, file = check(what, text)
    assert code == 2
    assert printed.out == ""
    assert printed.err.count("\n") == 1
    assert printed.err.startswith(f"cannot check {file}: ")
    assert told in printed.err or what == "--loop"


def test_nothing_to_check_is_said(capsys):
    with pytest.raises(SystemExit) as ended:
        main([])
    assert ended.value.code == 2
    assert "give --cases FILE, --loop FILE or both" in capsys.readouterr().err
