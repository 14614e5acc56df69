"""Probabilities against sums over all hypotheses, written out."""

from itertools import chain, combinations

import numpy as np
import pytest
from scipy.special import comb

from stages.science.discrepancy.evidence import Beside, weigh_names

CHANNELS = ["y", "y", "z"]
PRIORS = {"none": 0.4, "static_map": 0.1, "wave": 0.35, "kink": 0.25}
ALONE = Beside(
    np.array([1.0, -2.0, 0.5]),
    {
        ("wave", "short"): {0: 3.0, 1: -2.5},
        ("wave", "long"): {0: 2.0, 1: 0.5},
        ("kink", "only"): {0: 1.2, 1: -1.0, 2: 2.5},
    },
)
BESIDE = Beside(
    np.array([4.0, 0.5, 0.4]),
    {
        ("wave", "short"): {0: 4.5, 1: 0.4},
        ("wave", "long"): {0: 4.0, 1: 3.5},
        ("kink", "only"): {0: 4.1, 1: 0.5, 2: 3.5},
    },
)


def list_sets(places):
    return chain.from_iterable(combinations(places, count) for count in range(1, len(places) + 1))


def sum_hypotheses(power):
    """Return the weight of nothing, of a static map somewhere, and of each name, hypothesis by hypothesis."""
    weights = dict.fromkeys(PRIORS, 0.0)
    names = {"wave": ["short", "long"], "kink": ["only"]}
    for maps in [(), ("y",), ("z",), ("y", "z")]:
        prior = np.prod([PRIORS["static_map"] if each in maps else 1 - PRIORS["static_map"] for each in ("y", "z")])
        scores = [BESIDE if channel in maps else ALONE for channel in CHANNELS]
        powers = [power[channel] for channel in CHANNELS]
        base = [powers[place] * scores[place].none[place] for place in range(3)]
        weights["static_map" if maps else "none"] += PRIORS["none"] * prior * np.exp(sum(base))
        for name, forms in names.items():
            offering = [each for each in ("y", "z") if any(CHANNELS[p] == each for p in ALONE.forms[name, forms[0]])]
            for channel in offering:
                places = [p for p in ALONE.forms[name, forms[0]] if CHANNELS[p] == channel]
                for chosen in list_sets(places):
                    rest = sum(base[place] for place in range(3) if place not in chosen)
                    told = [rest + sum(powers[p] * scores[p].forms[name, form][p] for p in chosen) for form in forms]
                    likelihood = np.mean(np.exp(told))
                    share = 1.0 / len(offering) / len(places) / comb(len(places), len(chosen))
                    weights[name] += PRIORS[name] * prior * share * likelihood
    total = sum(weights.values())
    return {name: each / total for name, each in weights.items()}


LARGEST = (4.0 - 1.0) + (3.5 + 2.0)
"""Evidence for the wave beside a map in channel y, the largest there; in z none exceeds 3."""


@pytest.mark.parametrize(("most", "power"), [(1e3, {"y": 1.0, "z": 1.0}), (0.5 * LARGEST, {"y": 0.5, "z": 1.0})])
def test_probabilities_are_those_of_a_sum_over_all_hypotheses(most, power):
    said = weigh_names(ALONE, BESIDE, CHANNELS, PRIORS, most, lambda *_: True)
    assert said.names == pytest.approx(sum_hypotheses(power), rel=1e-9)
    assert said.forms["wave"][:2] == ["long", "long"]  # one cause has one form


def test_what_is_not_worth_it_has_no_probability_and_the_rest_share_it():
    said = weigh_names(ALONE, BESIDE, CHANNELS, PRIORS, 1e3, lambda name, *_: name != "wave")
    every = sum_hypotheses({"y": 1.0, "z": 1.0})
    rest = 1.0 - every.pop("wave")
    assert said.names == pytest.approx({"wave": 0.0} | {name: each / rest for name, each in every.items()}, rel=1e-9)


def test_the_outputs_that_carry_a_name_are_told():
    scores = Beside(np.zeros(3), {("wave", "only"): {0: 8.0, 1: -6.0}})
    said = weigh_names(scores, scores, CHANNELS, {"none": 0.5, "static_map": 1e-9, "wave": 0.5}, 1e3, lambda *_: True)
    first, second, both = 0.25 * np.exp(8.0), 0.25 * np.exp(-6.0), 0.5 * np.exp(2.0)
    expected = np.array([first + both, second + both, 0.0]) / (first + second + both)
    np.testing.assert_allclose(said.carries["wave"], expected, rtol=1e-9)


def test_beside_a_static_map_a_form_that_is_one_may_not_be_the_name():
    """What the map tells better than a patch of it is not then said by that patch."""
    alone = Beside(np.zeros(1), {("slack", "patch"): {0: 30.0}, ("slack", "opening"): {0: 0.0}})
    beside = Beside(np.array([60.0]), {("slack", "opening"): {0: 64.0}})
    offered = {}

    def worth(name, forms, likely, carries, mapped):
        offered[name] = list(likely)
        return True

    said = weigh_names(alone, beside, ["y"], {"none": 0.5, "static_map": 0.1, "slack": 0.5}, 1e3, worth)
    assert list(said.likely["slack"]) == offered["slack"] == ["opening"]
    assert said.mapped["slack"]
    mapped = Beside(np.array([10.0]), {("slack", "opening"): {0: 11.0}})
    said = weigh_names(alone, mapped, ["y"], {"none": 0.5, "static_map": 0.1, "slack": 0.5}, 1e3, worth)
    assert {*said.likely["slack"]} == {"patch"}  # the other has next to none of its probability
    assert not said.mapped["slack"]


def test_what_a_name_tells_of_another_channel_counts_under_the_limit_of_that_channel():
    forms = {("late", "only"): {0: 6.0}, ("lag", "only"): {0: 9.0}, ("wave", "only"): {1: 40.0}}
    scores = Beside(np.zeros(2), forms, {("late", "only"): {0: ("z", 30.0)}})
    priors = {"none": 0.25, "static_map": 1e-12, "late": 0.25, "lag": 0.25, "wave": 0.25}
    said = weigh_names(scores, scores, ["y", "z"], priors, 20.0, lambda *_: True).names
    weights = np.exp([0.0, 6.0 + 0.5 * 30.0, 9.0, 0.5 * 40.0])
    expected = dict(zip(("none", "late", "lag", "wave"), weights / weights.sum(), strict=True))
    assert {name: said[name] for name in expected} == pytest.approx(expected, rel=1e-6)
