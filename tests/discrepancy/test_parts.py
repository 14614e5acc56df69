"""Which trials are fitted, opened and only reported."""

import pytest
from pydantic import ValidationError

from stages.discrepancy import Parts, assign_parts

GIVEN = ["estimation"] * 8 + ["validation"] * 3 + ["arrow"] * 2


def choose(fitted=None, verification=None, last_share=None):
    return Parts(fitted=fitted, verification=verification, last_share=last_share)


def counted(purposes):
    return {part: [p for g, p in zip(GIVEN, purposes, strict=True) if g == part] for part in dict.fromkeys(GIVEN)}


def test_without_names_a_share_of_all_trials_is_opened():
    purposes = assign_parts(GIVEN, choose(fitted=None, verification=None), 0.375)
    assert purposes.count("verification") == 4
    assert purposes.count("fitted") == 9


def test_trials_are_opened_within_the_fitted_part_and_others_are_reported():
    purposes = counted(assign_parts(GIVEN, choose(fitted=["estimation"], verification=None), 0.375))
    assert purposes["estimation"].count("verification") == 3
    assert purposes["estimation"].count("fitted") == 5
    assert set(purposes["validation"] + purposes["arrow"]) == {"other"}


def test_a_part_named_for_verification_is_opened_whole():
    purposes = counted(assign_parts(GIVEN, choose(fitted=["estimation"], verification=["validation"]), 0.375))
    assert purposes == {
        "estimation": ["fitted"] * 8,
        "validation": ["verification"] * 3,
        "arrow": ["other"] * 2,
    }


def test_all_but_verification_is_fitted_where_nothing_is_named():
    purposes = counted(assign_parts(GIVEN, choose(fitted=None, verification=["arrow"]), 0.375))
    assert purposes["validation"] == ["fitted"] * 3


@pytest.mark.parametrize(
    ("fitted", "verification", "told"),
    [
        (["estimatoin"], None, "no part 'estimatoin' was recorded; did you mean 'estimation'"),
        (["arrow"], None, "at least 3 trials"),
        (None, ["estimation", "validation", "arrow"], "at least 2 trials to fit, got 0"),
    ],
)
def test_impossible_parts_are_refused(fitted, verification, told):
    with pytest.raises(ValueError, match=told):
        assign_parts(GIVEN, choose(fitted=fitted, verification=verification), 0.375)


def test_a_part_cannot_serve_for_both():
    with pytest.raises(ValidationError, match="got arrow in both"):
        choose(fitted=["arrow"], verification=["arrow", "validation"])


def test_the_last_trials_of_the_fitted_part_are_opened():
    purposes = counted(assign_parts(GIVEN, choose(fitted=["estimation"], last_share=0.4), 0.375))
    assert purposes["estimation"] == ["fitted"] * 5 + ["verification"] * 3
    assert set(purposes["validation"] + purposes["arrow"]) == {"other"}


def test_at_least_one_is_opened():
    assert assign_parts(GIVEN, choose(last_share=0.01), 0.375).count("verification") == 1


def test_the_last_and_a_named_part_cannot_both_be_opened():
    with pytest.raises(ValidationError, match="verification or last_share, got both"):
        choose(verification=["arrow"], last_share=0.4)
