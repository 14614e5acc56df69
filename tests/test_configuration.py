"""What the main job's configuration refuses, and with which words; nothing is run here."""

import pytest
from hydra import compose, initialize_config_dir
from hydra.core.override_parser.overrides_parser import OverridesParser

from pipeline.config import read_study
from pipeline.errors import ConfigError
from tests.conftest import ROOT

GROUPS = {
    path.name: sorted(each.stem for each in path.glob("*.yaml"))
    for path in (ROOT / "conf").iterdir()
    if path.is_dir() and path.name not in ("hydra", "experiment")
}


def validated(*overrides):
    with initialize_config_dir(str(ROOT / "conf"), version_base="1.3"):
        return read_study(compose("config", overrides=list(overrides)))


@pytest.mark.parametrize(
    ("override", "told"),
    [
        ("seed=-1", "seed: input should be greater than or equal to 0, got -1"),
        ("active_loop.trials=0", "active_loop.trials: input should be greater than 0, got 0"),
        ("active_loop.utility=yy", "active_loop.utility: input should be 'y_y', "),
        ("active_loop.memory_mb=0", "active_loop.memory_mb: input should be"),
        ("subsampling.every=0", "subsampling.every: input should be greater than 0, got 0"),
        ("bank.trajectories=0", "bank.trajectories: input should be greater than 0"),
        (
            "bank.pressure.range_kpa.pam1.low=900",
            "bank.pressure.range_kpa.pam1: expected low <= high, got 900.0 and 200",
        ),
        ("~bank.pressure.range_kpa.pam1", "bank.pressure.range_kpa: expected a range for every muscle, none for pam1"),
        ("+bank.pressure.range_kpa.pam5={low: 1.0,high: 2.0}", "no muscle 'pam5'; did you mean 'pam4'?"),
        ("hyperprior.rows.log_noise_sd.variance=0", "hyperprior.rows.log_noise_sd.variance: input should be greater"),
        ("~hyperprior.rows.log_noise_sd", "hyperprior.rows lacks log_noise_sd"),
        ("+hyperprior.muscles.pam9={}", "hyperprior.muscles: no muscle 'pam9'; did you mean 'pam4'?"),
        ("~hyperprior.data_sheet.MAS-10", "hyperprior.data_sheet has no type 'MAS-10' of pam2"),
        ("+plant.typo=1", "unknown key 'plant.typo'"),
        ("+participants.p1.dela_s=1", "unknown key 'participants.p1.dela_s': did you mean 'delay_s'?"),
        ("+rig.lead_inn_s=1", "unknown key 'rig.lead_inn_s': did you mean 'lead_in_s'?"),
        (
            "rig._target_=stages.rig.sim.SimulatedRg",
            "stages.rig.sim has no class SimulatedRg; did you mean 'SimulatedRig'?",
        ),
        ("rig._target_=stages.rig.simm.SimulatedRig", "cannot import stages.rig.simm"),
        ("+mucles=4", "unknown key 'mucles'"),
    ],
)
def test_refuses(override, told):
    with pytest.raises(ConfigError) as refusal:
        validated(override)
    assert told in str(refusal.value)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize("budget", ["full", "tiny"])
@pytest.mark.parametrize("plant", ["nominal", "rich"])
@pytest.mark.parametrize("participant", ["p1", "p2", "both"])
def test_accepts_every_option(budget, plant, participant):
    study, stages = validated(f"budget={budget}", f"plant={plant}", f"participant={participant}")
    assert list(study.values["participants"]) == (["p1", "p2"] if participant == "both" else [participant])
    assert stages[0].name == "bank"


def test_every_option_of_every_group_is_explained():
    for path in (ROOT / "conf").rglob("*.yaml"):
        lines = path.read_text().splitlines()
        comments = [line for line in lines[:2] if line.startswith("# ") and not line.startswith("# @package")]
        assert comments, f"{path} begins without a comment that says what it is"


def test_every_key_of_the_project_has_a_comment():
    silent = []
    for path in (ROOT / "conf").rglob("*.yaml"):
        if "hydra" in path.parts or path.parent.name == "budget":
            continue
        for number, line in enumerate(path.read_text().splitlines(), start=1):
            key, _, value = line.partition(":")
            is_value = value.strip() and not line.lstrip().startswith(("#", "- ", "_target_"))
            is_value = is_value and not value.strip().startswith(("${", "{low", "{name"))
            if is_value and "#" not in value and '"assumed' not in value and "source:" not in line:
                silent.append(f"{path.relative_to(ROOT)}:{number} {key.strip()}")
    assert not silent


def test_overrides_named_in_the_readme_parse_and_validate():
    found = []
    for line in (ROOT / "README.md").read_text().splitlines():
        for part in line.split("`"):
            if part.startswith("python -m pipeline ") and "rig=operator" not in part:
                found.append(part.split()[3:])
    assert found
    for overrides in found:
        OverridesParser.create().parse_overrides(overrides)
        validated(*overrides)
