"""The settings of the paper's analyses: they follow the budget, and nonsense is refused."""

import pytest
from omegaconf import OmegaConf
from pydantic import ValidationError

from stages.paper.baselines import Baselines
from stages.paper.hyperprior_sensitivity import HyperpriorSensitivity, MovementsEnough
from stages.paper.learned_models import LearnedModels
from stages.paper.time_shift import TimeShift, TrialsEnough
from tests.composing import compose_values

SECTIONS = {
    "baselines": Baselines,
    "hyperprior_sensitivity": HyperpriorSensitivity,
    "learned_models": LearnedModels,
    "time_shift": TimeShift,
}
VIEWS = {"hyperprior_sensitivity": MovementsEnough, "time_shift": TrialsEnough}


@pytest.fixture(scope="module")
def stated():
    composed = compose_values("budget=tiny", "experiment=paper_design", *(f"+{name}=default" for name in SECTIONS))
    return OmegaConf.to_container(composed, resolve=True)


def test_follow_the_budget(stated):
    found = {name: model.model_validate(stated[name]) for name, model in SECTIONS.items()}
    assert found["baselines"].starts == 2
    for name, view in VIEWS.items():
        assert (found[name].experiments, found[name].loop.trials, found[name].loop.starts) == (1, 3, 2)
        view.model_validate(stated)


def change(stated, key, value):
    changed = OmegaConf.create(stated)
    OmegaConf.update(changed, key, value, force_add=True)
    return OmegaConf.to_container(changed)


PER_ITEM = r"each value once.*hyperprior_sensitivity.mean_shifts=\[0.5"


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("baselines.experiments", 0, "greater than 0"),
        ("baselines.slack_share", 1.0, "less than 1"),
        ("hyperprior_sensitivity.mean_shifts", [0.5, 0.5], PER_ITEM),
        ("hyperprior_sensitivity.mean_shifts", [], "at least 1 item"),
        ("hyperprior_sensitivity.variance_factors", [1.0], "less than 1"),
        ("learned_models.surfaces.grid", 1, "greater than or equal to 2"),
        ("time_shift.amplitudes_s", [0.3, 0.1], r"first, got \[0.3, 0.1\]; set time_shift.amplitudes_s=\[0.1, 0.3"),
        ("time_shift.loop.trial", 3, "Extra inputs"),
    ],
)
def test_nonsense_is_refused(stated, key, value, message):
    name = key.split(".")[0]
    with pytest.raises(ValidationError, match=message):
        SECTIONS[name].model_validate(change(stated, key, value)[name])


@pytest.mark.parametrize(
    ("name", "key", "value", "message"),
    [
        ("hyperprior_sensitivity", "bank.trajectories", 4, r"sensitivity\.loop\.trials: expected at most 2"),
        ("time_shift", "bank.trajectories", 4, r"time_shift\.loop\.trials: expected at most 2"),
        ("time_shift", "time_shift.loop.utility", "predictive_information", "asks for no task"),
        ("time_shift", "time_shift.amplitudes_s", [0.003], r"from one sample, 0\.004 s, to a trial, 4 s, got \[0\.003"),
    ],
)
def test_what_does_not_fit_the_recordings_is_refused(stated, name, key, value, message):
    with pytest.raises(ValidationError, match=message):
        VIEWS[name].model_validate(change(stated, key, value))
