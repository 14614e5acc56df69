"""The check of utilities: ranks against SciPy, regrets against closed forms, verdicts that planted data turn."""

from itertools import product

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from stages.paper.utility_check import (
    CHOICES,
    TARGETS,
    UTILITY_AGREEMENT,
    UTILITY_SUMMARY,
    agree,
    forgo,
    rely,
    summarise,
)


def test_ranks_and_regrets_are_those_of_the_definition(generator):
    scores, information = generator.random(40), generator.random(40)
    spearman, regret = agree(scores, information)
    assert spearman == pytest.approx(stats.spearmanr(scores, information).statistic)
    assert regret == pytest.approx(1 - information[np.argmax(scores)] / information.max())
    assert agree(information**3, information) == (pytest.approx(1.0), 0.0)
    worst = 1 - information.min() / information.max()
    assert agree(-information, information) == (pytest.approx(-1.0), pytest.approx(worst))
    drawn = 1 - information[generator.integers(40, size=200_000)] / information.max()
    expected = pytest.approx(drawn.mean(), abs=4 * drawn.std() / np.sqrt(drawn.size))
    assert forgo(information.mean(), information) == expected  # of a random choice


def test_equal_scores_have_no_rank(generator):
    spearman, regret = agree(np.ones(5), np.arange(1.0, 6.0))
    assert np.isnan(spearman)
    assert regret == pytest.approx(0.8)
    assert forgo(0.0, np.zeros(4)) == 0.0


def plant(generator, regrets, experiments=6):
    """Return `utility_agreement` with each utility's regret around a mean of its own."""
    keys = product(("p1", "p2"), range(1, experiments + 1), (0, 5, 10), TARGETS, CHOICES)
    rows = [(*key, 0.5, regrets.get(key[-1], 0.3) + 0.005 * generator.random(), 0.9, 2.0, 0.1) for key in keys]
    return UTILITY_AGREEMENT.check(pd.DataFrame(rows, columns=list(UTILITY_AGREEMENT.columns)), "test")


@pytest.mark.parametrize(
    ("regret", "verdict"), [(0.1, "forgoes less than y_y"), (0.5, "forgoes more than y_y"), (0.3, "undecided")]
)
def test_planted_regrets_turn_the_verdict(regret, verdict, generator):
    told = UTILITY_SUMMARY.check(summarise(plant(generator, {"variance": regret})), "test")
    its = told[told["utility"] == "variance"]
    assert (its["verdict"] == verdict).all()
    assert (its["n"] == 12).all()
    assert (told.loc[told["utility"] == "y_y", "verdict"] == "the design").all()


def test_experiments_are_the_unit_and_agree_with_scipy(generator):
    agreement = plant(generator, {"variance": 0.31})
    told = summarise(agreement).set_index(["target", "utility"]).loc[("together", "variance")]
    its = agreement[agreement["target"] == "together"]
    means = its.groupby(["utility", "participant", "experiment"])["regret"].mean()
    expected = stats.ttest_rel(means["variance"].to_numpy(), means["y_y"].to_numpy())
    assert (told["low"], told["high"]) == pytest.approx(tuple(expected.confidence_interval()), rel=1e-9)
    assert told["regret"] == pytest.approx(means["variance"].mean())


def test_reliability_is_the_agreement_of_two_estimates(generator):
    information = generator.random(400)
    for sd in (0.5, 3.0):
        densities = information + sd * generator.standard_normal((2, 64, 400))
        first, second = (each.mean(axis=0) for each in densities)
        again = stats.spearmanr(first, second).statistic
        assert rely(densities[0]) == pytest.approx(again, abs=0.1)
    assert rely(np.tile(information, (8, 1))) == pytest.approx(1.0)
    assert np.isnan(rely(np.ones((8, 5))))
    opposed = np.where(np.arange(8)[:, None] % 2, information[:5], -information[:5])
    assert rely(opposed) == pytest.approx(-1.0)


def test_utilities_are_checked_on_the_models_of_a_run(shared_run, tmp_path):
    command = shared_run.copy(tmp_path / "outputs")
    stages = "bank,subsampling,hyperprior,task,hardware,active_loop,model_selection,comparison,participant_differences,"
    stages += "tracking_delay,utility_check"
    result = command("+utility_check=default", f"workflow.stages=[{stages}]", "stages=[utility_check]")
    assert result.returncode == 0, result.stderr
    told = pd.read_parquet(command.runs[-1] / "tables" / "utility_agreement.parquet")
    assert (told.groupby(["experiment", "trial", "target"])["utility"].agg(set) == {*CHOICES}).all()
    assert (told.groupby("target")["regret"].min() < 0.1).all()  # some choice is near the most telling trajectory
    assert (told.loc[told["utility"] == "random", "regret"] > 0.0).all()
    assert (command.runs[-1] / "figures" / "utility_agreement.png").stat().st_size > 1000
