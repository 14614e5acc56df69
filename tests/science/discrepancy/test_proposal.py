"""The trial that is proposed: its evidence against refits by least squares, its range, and what it is for."""

from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
import pandas as pd
import pytest

from stages.benchmark.blinded_rig.dataset import simulate
from stages.benchmark.blinded_rig.scenarios import named_scenario
from stages.science.discrepancy.excitations import list_excitations
from stages.science.discrepancy.fitted_channel import prepare
from stages.science.discrepancy.muscle_dataset import build_muscle_channels
from stages.science.discrepancy.parts import Parts, assign_parts
from stages.science.discrepancy.proposal import (
    choose_rivals,
    choose_round,
    expect_evidence,
    fit_rival,
    propose,
    weigh_rivals,
)
from stages.science.discrepancy.report_text import describe_proposal
from stages.science.discrepancy.trial_scores import compare_by
from stages.science.recording.datasets import tabulate_session
from tests.science.discrepancy.searches import DISCREPANCY, SETTINGS
from tests.science.discrepancy.simulated_records import build_records, configured, tabulate, wander
from tests.science.discrepancy.toys import KINK, WAVE, Toy, make_toy

EVEN = {"wave": 0.5, "kink": 0.5}


@dataclass(frozen=True)
class DrivenToy(Toy):
    """A toy whose x can be prescribed."""

    jitters = False
    levers = ("x",)

    def excite(self, shares):
        x = self.x.min() + shares["x"] * np.ptp(self.x)
        same = {"channel": self.channel, "element": self.element, "offered": self.offered}
        return type(self)(x, np.zeros_like(x), np.ones(x.shape, dtype=bool), np.zeros(x.shape[1]), **same)

    def tell_levers(self):
        return {"x": self.x}


def make_driven(hidden=((WAVE.effect, 0.3),), **how):
    return DrivenToy(**vars(make_toy(3, hidden, noise=0.1, trials=4, **how)))


class Jittering(DrivenToy):
    """One whose trials have offsets and gains."""

    jitters = True


def find_rivals(kind):
    state = prepare(kind(**vars(make_driven())))
    return state, [fit_rival([state], *each) for each in EVEN.items()]


@pytest.fixture(scope="module")
def rivals():
    return find_rivals(DrivenToy)


@pytest.mark.parametrize("kind", [DrivenToy, Jittering])
def test_evidence_is_what_is_left_when_the_other_is_fitted_to_old_and_new_trials(kind):
    state, both = find_rivals(kind)
    _, shares = list_excitations(["x"], 300, 0.01, 1.0)
    other = state.output.excite(shares)
    evidence = expect_evidence(both, [other], SETTINGS.largest_jitter)[0, 1, :, 0]
    best = min((each.fits[0] for each in both), key=lambda each: each.raw.sum())
    scores = compare_by(state.output, best.residual, SETTINGS.largest_jitter)
    weight = scores.effective / state.output.present.sum() / (best.raw.sum() / state.output.present.sum())
    wrong = both[1].fits[0].fit
    told = [each.fits[0].fit.model.name_values(each.fits[0].fit.values) for each in both]
    (a, b, c), (d, e, f) = (  # a wrong effect may take nothing, and is left out then
        [*constants.values(), effects[0][1]["size"] if effects else 0.0] for constants, effects in told
    )
    for k in range(other.trials):
        new = other.x[:, k]
        true = a + b * new + c * WAVE.effect(new)
        apart = true - (d + e * new + f * KINK.effect(new))
        rows = [
            np.column_stack([np.ones(x.size), x.ravel(), KINK.effect(x).ravel()])[:, : wrong.free.size][:, wrong.free]
            for x in (state.output.x, new)
        ]
        sd = wrong.model.prior[1][wrong.free]
        design = np.vstack([np.sqrt(weight) * np.vstack(rows), np.diag(1.0 / sd)])
        target = np.concatenate([np.zeros(len(rows[0])), np.sqrt(weight) * apart, np.zeros(len(sd))])
        if kind is Jittering:  # an offset and a gain of the new trial are free
            own = np.zeros((len(target), 2))
            own[len(rows[0]) : len(rows[0]) + len(new)] = np.column_stack([np.ones(len(new)), true])
            design = np.hstack([design, own])
        found = np.linalg.lstsq(design, target, rcond=None)[0]
        assert evidence[k] == pytest.approx(0.5 * float(((target - design @ found) ** 2).sum()), rel=1e-4, abs=1e-6)


def test_the_proposed_trial_tells_more_than_most_and_stays_in_what_was_seen(rivals):
    state, _ = rivals
    weighed = propose([state], EVEN, SETTINGS.largest_jitter)
    best = weighed.order[0]
    x, seen = weighed.outputs[0].x, state.output.x
    assert seen.min() <= x.min() < x.max() <= seen.max()
    assert np.abs(np.diff(x, axis=0)).max() <= np.abs(np.diff(seen, axis=0)).max()
    assert weighed.expected_now == pytest.approx(0.5)
    assert weighed.probability[best] == weighed.probability.max() > weighed.expected_now
    assert weighed.mean_evidence[best] > np.median(weighed.mean_evidence)
    assert weighed.spell(best).startswith("x ")


def test_where_all_is_faster_than_what_was_seen_nothing_is_proposed(rivals):
    state, _ = rivals
    still = DrivenToy(**{**vars(state.output), "x": np.tile(np.linspace(0.0, 0.2, 300)[:, None], 4)})
    slow = prepare(still)
    assert propose([slow], EVEN, SETTINGS.largest_jitter) is None


def test_a_muscle_is_driven_within_what_it_did_and_both_of_a_joint_agree():
    recorded = simulate(replace(named_scenario("none-1000"), trials=2))
    outputs = build_muscle_channels(tabulate_session(recorded.samples, recorded.meta, ""), DISCREPANCY)
    first = outputs[0]
    kinds, shares = list_excitations(first.levers, len(first.measured), first.step_s, first.time_scale_s)
    angles = {}
    for output in outputs:
        driven = output.excite(shares)
        assert driven.trials == len(kinds) > 40
        seen, told = output.tell_levers(), driven.tell_levers()
        for name, values in told.items():
            assert values.min() >= seen[name].min() - 1e-9
            assert values.max() <= seen[name].max() + 1e-9
        constants = {each.name: each.prior_mean for each in output.constants}
        assert np.isfinite(driven.simulate(constants, [])).all()
        build = output.build
        angles[output.element] = (told["contraction"] - build.contraction_at_angle_0) / build.contraction_per_rad
    joint = {muscle: sheet["joint"] for muscle, sheet in recorded.meta["muscles"].items()}
    for one, other in combinations(angles, 2):
        if joint[one] == joint[other]:
            np.testing.assert_allclose(angles[one], angles[other], atol=1e-9)


def test_other_records_are_what_the_machine_does_under_other_inputs():
    generator = np.random.default_rng(0)
    plant = configured("first_order")
    name = plant.inputs[0]
    recorded = {name: wander(generator, 1600, 80), plant.output: wander(generator, 1600, 80)}
    output = build_records(*tabulate(recorded, 0.01, blocks=4), plant)
    kinds, shares = list_excitations(output.levers, len(output.measured), output.step_s, output.time_scale_s)
    driven = output.excite(shares)
    constants = {each.name: each.prior_mean for each in output.constants}
    answer = driven.simulate(constants, [])
    for place in range(len(kinds)):
        given = {name: driven.tell_levers()[name][:, place], plant.output: answer[:, place]}
        again = build_records(*tabulate(given, output.step_s, blocks=1), output.plant)
        same = again.simulate(constants, [])[:, 0]  # but for where it is told to begin
        np.testing.assert_allclose(same[5:], answer[5:, place], atol=1e-3 * np.ptp(recorded[plant.output]))


def test_probability_after_a_trial_is_that_of_bayes():
    now = np.array([0.7, 0.3])
    evidence = np.zeros((2, 2, 2))
    evidence[0, 1, 1], evidence[1, 0, 1] = 2.0, 3.0
    told = weigh_rivals(now, evidence)
    assert told[0] == pytest.approx(0.7**2 + 0.3**2)
    first, second = 0.7 / (0.7 + 0.3 * np.exp(-2.0)), 0.3 / (0.3 + 0.7 * np.exp(-3.0))
    assert told[1] == pytest.approx(0.7 * first + 0.3 * second)


NOBODY = pd.DataFrame(columns=["round", "name", "probability", "indistinguishable_from"])


def test_rivals_are_the_leading_names_of_the_least_sure_round():
    rows = [
        (1, "none", 0.0, 0.05, False),
        (1, "wave", 0.999, 0.02, False),
        (1, "unknown", 0.0, 0.05, False),
        (2, "kink", 0.6, 0.011, False),
        (2, "static_map", 0.3, 0.01, False),
        (2, "line", 0.02, 0.012, False),
        (2, "bend", 0.05, 0.013, False),
        (2, "gain", 0.03, 0.02, True),
        (3, "none", 0.4, 0.01, False),
    ]
    ranking = pd.DataFrame(rows, columns=["round", "name", "probability", "heldout_gap", "absorbed"])
    named = pd.DataFrame({"round": [1, 2], "name": ["wave", "kink"], "indistinguishable_from": ["", "line"]})
    found = choose_round(ranking, named, NOBODY, 3, 0.01)
    assert (found.number, found.standing, found.leading) == (2, 1, 0.6)
    assert list(found.rivals) == ["kink", "line", "bend"]
    assert sum(found.rivals.values()) == pytest.approx(1.0)
    assert found.rivals["kink"] == pytest.approx(0.6 / 0.67)
    assert choose_round(ranking, named[:0], NOBODY, 3, 0.01) is None
    held = pd.DataFrame({"round": [2], "name": ["kink"], "probability": [0.5], "indistinguishable_from": ["line"]})
    with_none = pd.concat([ranking, ranking[:1].assign(round=2)])
    found = choose_round(with_none, named[:1], held, 3, 0.01)
    assert (found.number, found.standing, list(found.rivals)) == (2, 1, ["kink", "none", "line"])
    assert found.rivals["kink"] > found.rivals["none"] > found.rivals["line"]
    vanished = with_none.assign(probability=with_none["probability"].where(with_none["name"] != "kink", 0.0))
    assert choose_round(vanished, named[:1], held, 3, 0.01).rivals["kink"] == pytest.approx(0.5 / 1.01)
    assert list(choose_rivals(ranking[ranking["round"] == 2], [], 3, 0.04)) == ["kink", "bend"]


def test_names_that_both_stand_are_no_rivals_and_what_is_left_beside_them_is():
    rows = [
        (1, "wave", 0.6, 0.02, False),
        (1, "kink", 0.4, 0.03, False),
        (2, "line", 0.5, 0.01, False),
        (2, "hump", 0.5, 0.012, False),
        (3, "kink", 0.97, 0.01, False),
        (3, "bend", 0.02, 0.012, False),
        (4, "none", 0.8, 0.01, False),
        (4, "bend", 0.15, 0.009, False),
        (4, "unknown", 0.05, 0.01, False),
    ]
    ranking = pd.DataFrame(rows, columns=["round", "name", "probability", "heldout_gap", "absorbed"])
    both = pd.DataFrame({"round": [1, 3, 0], "name": ["wave", "kink", "count"], "indistinguishable_from": ""})
    late = ranking[ranking["round"] != 2]  # what the second round added was taken out again
    found = choose_round(late, both, NOBODY, 3, 0.01)
    assert (found.number, found.standing, list(found.rivals)) == (4, 2, ["none", "bend"])
    assert choose_round(late[late["name"] != "bend"], both, NOBODY, 3, 0.01) is None
    found = choose_round(ranking, both, NOBODY, 3, 0.01)
    assert (found.number, found.standing, list(found.rivals)) == (2, 1, ["line", "hump"])
    alike = both.assign(indistinguishable_from=["kink", "", ""])
    assert list(choose_round(late, alike, NOBODY, 3, 0.01).rivals) == ["wave", "kink"]


@pytest.mark.parametrize(("nameless", "rivals"), [(0.55, {}), (0.3, {"kink": 0.75, "none": 0.25})])
def test_where_a_family_without_a_name_leads_no_name_has_a_rival(nameless, rivals):
    left = 1.0 - nameless
    probabilities = {"static_map": nameless, "kink": 0.75 * left, "none": 0.25 * left, "bend": 1e-9}
    rows = [(name, probability, 0.01, False) for name, probability in probabilities.items()]
    ranking = pd.DataFrame(rows, columns=["name", "probability", "heldout_gap", "absorbed"])
    assert choose_rivals(ranking, [], 3, 0.01) == pytest.approx(rivals)


def test_a_trial_that_hardly_raises_the_probability_of_the_true_name_is_not_proposed(rivals):
    state, _ = rivals
    weighed = propose([state], EVEN, SETTINGS.largest_jitter)
    assert describe_proposal(EVEN, weighed, 0.9 * weighed.gain).startswith("To tell ")
    refused = describe_proposal(EVEN, weighed, 1.1 * weighed.gain)
    assert refused.startswith(
        f"No further trial is proposed: the best of these kinds ({weighed.spell(weighed.order[0])})"
    )
    assert describe_proposal({"kink": 1.0}, None, 0.0).startswith("No further trial is proposed: there are no two")


def test_proposed_trials_are_fitted_and_others_opened():
    parts = Parts(fitted=None, verification=None, last_share=None, gap_share=0.0)
    purposes = assign_parts(["given"] * 8 + ["proposed"] * 3, parts, 0.375, [""] * 11)
    assert purposes[8:] == ["fitted"] * 3
    assert purposes[:8] == assign_parts(["given"] * 8, parts, 0.375, [""] * 8)
