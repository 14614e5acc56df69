"""The gap on the test trials that the scorecard reads is the one computed by hand."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import ttest_1samp

from stages.science.scorecard.judgement import judge
from tests.science.discrepancy.searches import DISCREPANCY
from tests.science.discrepancy.toys import WAVE, make_toy

TEST = [1, 5, 6]


def make_output(seed, name, scale):
    toy = make_toy(seed, [(WAVE.effect, 1.0)], offered=(WAVE,), element=name, trials=8, samples=120)
    present = toy.present.copy()
    present[:40, 5], present[:, 6] = False, False
    return replace(toy, measured=scale * toy.measured, present=present)


@pytest.fixture(scope="module")
def judged():
    outputs = [make_output(1, "one", 1.0), make_output(2, "two", 3.0)]
    return judge(outputs, TEST, DISCREPANCY, lambda *part: np.random.default_rng(len(part)))


def test_the_gap_is_the_root_mean_square_over_trials_and_outputs(judged):
    for fits in (judged.decision.steps[0], judged.decision.steps[-1]):
        squares = []
        for output, fitted in zip(judged.outputs, fits, strict=True):
            constants, effects = fitted.fit.model.name_values(fitted.fit.values)
            wrong = output.measured - output.simulate(constants, effects)
            shares = [wrong[output.present[:, k], k] / output.range for k in TEST if output.present[:, k].any()]
            squares.append(np.mean([np.mean(share**2) for share in shares]))
        assert judged.gap(fits, {"y"}) == pytest.approx(np.sqrt(np.mean(squares)), rel=1e-9)


def test_the_wave_is_found_and_the_test_trials_fall_to_the_noise(judged):
    assert [each.name for each in judged.decision.effects] == ["wave"]
    before, after = (judged.gap(judged.decision.steps[place], {"y"}) for place in (0, -1))
    assert after < 0.5 * before
    assert judged.floor({"y"}) == pytest.approx(after, rel=0.2)


def test_further_trials_compare_the_amended_with_the_nominal_model_either_way(judged):
    further = [1, 5, 7]
    gained = []
    for place in (0, -1):
        left = 0.0
        for output, fitted in zip(judged.outputs, judged.decision.steps[place], strict=True):
            wrong = output.measured - output.simulate(*fitted.fit.model.name_values(fitted.fit.values))
            each = [np.mean(wrong[output.present[:, k], k] ** 2) for k in further]
            left = left + np.array(each) / output.range**2
        gained.append(left)
    told = (gained[0] - gained[1]) / gained[0].mean()
    interval = ttest_1samp(told, 0.0).confidence_interval(0.95)
    found = judged.compare_further(judged.outputs, further, 0.95)
    assert found == pytest.approx((told.mean(), interval.low, interval.high))
    assert found[1] > 0.0
    steps = judged.decision.steps
    swapped = replace(judged, decision=replace(judged.decision, steps=[*steps[:-1], steps[0]]))
    assert swapped.compare_further(judged.outputs, further, 0.95) == (0.0, 0.0, 0.0)
    worse = replace(judged, decision=replace(judged.decision, steps=steps[::-1]))
    assert worse.compare_further(judged.outputs, further, 0.95)[2] < 0.0
