"""The search on toys with planted effects, which turn out both ways."""

from dataclasses import replace

import numpy as np
import pytest

from stages.science.discrepancy.decision import decide
from stages.science.discrepancy.fitted_channel import prepare, refine, resume
from stages.science.discrepancy.ranking import rank_first
from stages.science.discrepancy.remainder import weigh_remainder
from stages.science.discrepancy.screening import screen
from stages.science.discrepancy.search import search
from stages.science.output_channels.fitting import Model, fit
from stages.science.output_channels.flexible import Leftover
from stages.science.output_channels.output_channel import list_starts
from tests.science.discrepancy.searches import DISCREPANCY, SETTINGS
from tests.science.discrepancy.toys import KINK, LINE, RISING, WAVE, make_toy

TWO = make_toy(1, [(WAVE.effect, 0.5), (RISING.effect, 0.6)], offered=(WAVE, KINK, RISING))


def run(*toys):
    found = search([prepare(each) for each in toys], SETTINGS, np.random.default_rng(0))
    return found, decide(found, DISCREPANCY, np.random.default_rng(1))


@pytest.mark.parametrize(("form", "size"), [(WAVE, 0.4), (KINK, 2.0)])
@pytest.mark.parametrize("seed", range(2))
def test_a_planted_effect_is_named(form, size, seed):
    found, said = run(make_toy(seed, [(form.effect, size)]))
    assert (said.status, [each.name for each in said.effects]) == ("named", [form.name])
    assert said.effects[0].probability > 0.9
    assert said.unknown < 0.1
    first = rank_first(found, said, 0.9)[0]
    assert (first["round"], first["name"], first["form"], first["site"]) == (1, form.name, "only", "muscle")
    assert found.outputs[0].current.fit.values[-1] == pytest.approx(size, rel=0.15)


@pytest.mark.parametrize("wander", [0.0, 0.05])
@pytest.mark.parametrize("seed", range(5))
def test_nothing_is_named_where_nothing_is_missing(seed, wander):
    _, said = run(make_toy(seed, wander=wander))
    assert (said.status, said.effects) == ("no_discrepancy", [])
    assert said.missing < 0.5


@pytest.mark.parametrize("seed", range(2))
def test_a_floor_that_may_hide_a_gap_is_not_called_nothing(seed):
    """The wander is 3 % of the range: what acts as little would not be seen."""
    _, said = run(make_toy(seed, wander=0.16))
    assert (said.status, said.effects, said.missing >= 0.5) == ("unexplained", [], True)


def test_two_effects_are_named_both_also_by_a_search_that_is_resumed():
    state = prepare(TWO)
    kept = resume(state.output, state.nominal.fit.values, state.noise, state.nominal.residual, state.leftover)
    found, again = (search([each], SETTINGS, np.random.default_rng(0)) for each in (state, kept))
    assert {each.name for each in found.named} == {"wave", "rising"}
    assert len(found.steps) == 3
    assert again.named == found.named
    values = [each.outputs[0].current.fit.values for each in (again, found)]
    np.testing.assert_allclose(*values, rtol=1e-6)


def test_an_effect_that_the_constants_imitate_is_told_absorbed_and_not_named():
    found, _ = run(make_toy(2, [(LINE.effect, 0.4)]))
    assert not found.named
    assert found.rounds[0].confounded_with_constants["line"] > 0.99
    assert found.rounds[0].confounded_with_constants["wave"] < 0.9


@pytest.mark.parametrize("seed", range(3))
def test_what_no_form_explains_is_left_unexplained(seed):
    def step(x):
        return np.where(np.abs(x - 0.2) < 0.35, 1.0, 0.0)

    _, said = run(make_toy(seed, [(step, 0.8)], offered=(LINE, KINK)))
    assert (said.status, said.effects) == ("unexplained", [])
    assert said.missing > 0.5
    assert said.remainders["y"].share > SETTINGS.unexplained_share


def test_the_element_that_carries_it_is_named():
    found, _ = run(make_toy(1, [(WAVE.effect, 0.4)], element="first"), make_toy(2, element="second"))
    assert [(each.name, each.elements) for each in found.named] == [("wave", ("first",))]


@pytest.mark.parametrize("size", [0.5, 1.5, 4.0])
def test_screening_does_not_miss_what_full_fits_find(size):
    state = prepare(make_toy(5, [(KINK.effect, size)]))
    promised = screen(state.nominal.fit, state.noise, state.output.forms)
    best = max(promised, key=lambda each: each.gain)
    full = {}
    for form in state.output.forms:
        starts = [np.append(state.nominal.fit.values, start["size"]) for start in list_starts(form)]
        full[form.name] = min(refine(Model(state.output, (form,)), start, 0.2).raw.sum() for start in starts)
    assert best.form.name == min(full, key=full.__getitem__) == "kink"


def test_screening_takes_a_form_at_the_size_that_a_full_fit_finds():
    # Few samples: the priors of the constants count, and that of the size, which screening leaves out, moves it 5 %.
    state = prepare(make_toy(0, [(WAVE.effect, 2.0)], offered=(WAVE,), noise=3.0, trials=4, samples=12))
    (promised,) = screen(state.nominal.fit, state.noise, state.output.forms)
    fitted = fit(Model(state.output, (WAVE,)), state.noise, np.append(state.nominal.fit.values, 2.0))
    assert promised.start["size"] == pytest.approx(fitted.values[-1], rel=0.1)


@pytest.fixture(scope="module")
def clean():
    """A wave that its own form explains, and what is left of it."""
    return run(make_toy(5, [(WAVE.effect, 0.8)], offered=(WAVE,), noise=0.05))


def test_a_name_that_leaves_more_than_its_forms_differ_by_is_doubted(clean):
    def bent(x):  # by the direction of motion, which no static map tells
        return np.sin(3.0 * x) + 0.3 * np.where(np.abs(x - 0.7) < 0.3, np.sign(np.gradient(x, axis=0)), 0.0)

    single, sure = clean
    found, said = run(make_toy(5, [(bent, 0.8)], offered=(WAVE,), noise=0.05))
    left = said.remainders["y"]
    assert [each.name for each in (*single.named, *found.named)] == ["wave", "wave"]
    assert sure.remainders["y"].ambiguous < 0.05
    assert sure.doubts[0]["y"] < 0.05
    assert 0.03 < left.share < SETTINGS.unexplained_share
    assert left.ambiguous > 0.5
    assert said.doubts[0]["y"] == pytest.approx(SETTINGS.ambiguous_weight * left.ambiguous)


@pytest.mark.parametrize(
    ("names", "shown", "doubt"), [(2, False, 0.0), (3, False, SETTINGS.ambiguous_weight), (3, True, 0.0)]
)
def test_many_names_in_a_channel_may_be_one_without_a_name(names, shown, doubt, clean):
    single = clean[0].named
    many = replace(clean[0], named=[*single * (names - 1), replace(single[0], shown=shown)])
    left = weigh_remainder(many, many.named, many.steps[-1], SETTINGS, np.random.default_rng(1))
    assert left["y"].doubt == pytest.approx(doubt, abs=0.05)


@pytest.mark.parametrize("step", [1, 0])
def test_a_name_that_was_not_added_keeps_its_probability_where_it_leaves_nothing(step, clean):
    found = clean[0]
    verdicts = replace(found.rounds[0].verdicts, names={"none": 0.0, "wave": 0.3, "memory": 0.7}, maps={"y": 0.0})
    undecided = replace(
        found,
        rounds=[replace(found.rounds[0], verdicts=verdicts, named=None)],
        named=[],
        steps=found.steps[:1],
        undecided=found.steps[step],
    )
    said = decide(undecided, DISCREPANCY, np.random.default_rng(1))
    rows = {row["name"]: row["probability"] for row in rank_first(undecided, said, 0.9)}
    assert next(iter(rows.items())) == ("memory", 0.7)
    assert rows["wave"] == pytest.approx(0.3 * step, abs=0.03)
    assert rows["unknown"] == pytest.approx(0.3 * (1 - step), abs=0.03)
    assert (said.status, said.remainders["y"].family) == ("unexplained", "memory")


def test_a_doubted_name_is_as_probable_in_the_ranking_as_in_what_is_said(clean):
    found, said = clean
    names = {"wave": 0.6, "memory": 0.3, "none": 0.1}
    rival = replace(found.rounds[0].verdicts, names=names, carries=dict.fromkeys(names, np.ones(1)))
    doubted = replace(said, doubts=[{"y": 0.3}] * len(found.rounds))
    looked = replace(found, rounds=[replace(found.rounds[0], verdicts=rival), *found.rounds[1:]])
    rows = {row["name"]: row["probability"] for row in rank_first(looked, doubted, 0.9) if row["round"] == 1}
    assert rows["wave"] == replace(found.named[0], probability=0.6).doubt(0.3) == 0.6
    assert rows["memory"] == pytest.approx(0.3)
    assert sum(rows.values()) == pytest.approx(1.0)


def test_a_name_that_left_out_trials_do_not_confirm_is_suspected_and_taken_out_again(clean):
    single = clean[0]
    idle = [replace(each, raw=1e4 * each.raw) for each in single.steps[1]]
    doubted = decide(replace(single, steps=[single.steps[0], idle]), DISCREPANCY, np.random.default_rng(1))
    assert (doubted.status, doubted.effects) == ("unexplained", [])
    assert [each.name for each in doubted.suspected] == ["wave"]
    assert doubted.suspected[0].p_value > 0.05
    assert doubted.steps == [single.steps[0]]


def test_a_name_built_on_a_doubted_one_is_doubted_twice():
    found, said = run(TWO)
    assert len(said.effects) == 2
    doubting = SETTINGS.model_copy(update={"ambiguous_share": -1.0})  # whatever is left, it is too much
    left = decide(found, DISCREPANCY.model_copy(update={"search": doubting}), np.random.default_rng(1))
    sure = 1.0 - SETTINGS.ambiguous_weight
    assert [each.probability for each in (*left.effects, *left.suspected)] == pytest.approx([sure, sure**2])
    assert [each.name for each in left.effects] == [found.named[0].name]


def test_one_of_two_names_is_taken_out_and_the_other_stays():
    found, said = run(TWO)
    assert [each.name for each in said.effects] == [each.name for each in found.named]
    first, second = found.named
    doubted = replace(found, named=[replace(first, probability=0.4), second])
    unlikely = decide(doubted, DISCREPANCY, np.random.default_rng(1))
    assert [each.name for each in unlikely.suspected] == [first.name]
    assert [each.name for each in unlikely.effects] == [second.name]
    assert [[form.name for form in step[0].forms] for step in unlikely.steps] == [[], [second.name]]


def test_a_second_channel_is_looked_at_though_no_gap_was_seen_in_it():
    """A flexible model may be blind where a named effect sees: the second round looks there too."""
    seen = prepare(make_toy(3, [(WAVE.effect, 0.5)], element="first"))
    blind = prepare(make_toy(4, [(KINK.effect, 2.5)], element="second", channel="z"))
    blind = replace(blind, leftover=Leftover(blind.nominal.raw, blind.nominal.residual, None))
    found = search([seen, blind], SETTINGS, np.random.default_rng(0))
    assert {each.name for each in found.named} == {"wave", "kink"}


def bend(x):
    """Return a smooth law that no form of the toys has."""
    return 0.3 * x**2 - 0.2 * x**4 + 0.15 * np.cos(2.0 * x)


@pytest.mark.parametrize("beside", [[], [(RISING.effect, 0.6)]], ids=["nothing else", "an effect that is no map"])
@pytest.mark.parametrize("seed", range(3))
def test_a_wrong_law_is_a_static_map_and_no_name_and_what_is_no_map_keeps_its_name(seed, beside):
    found, said = run(make_toy(seed, [(bend, 1.0), *beside], offered=(WAVE, KINK, RISING) if beside else (WAVE, KINK)))
    assert said.remainders["y"].family == "static_map"
    assert [each.name for each in said.effects] == (["rising"] if beside else [])
    assert beside or said.status == "unexplained"
    assert beside or found.rounds[0].verdicts.names["static_map"] > 0.5
