import re

import pytest
from pydantic import ValidationError

from stages.science.plant.exoskeleton import Exoskeleton
from stages.science.plant.plant import Plant
from tests.science.plant.machines import CONF, configured, with_effects

FILES = [CONF / "rig" / "sim.yaml"]
FILES += [path for group in ("plant", "participant", "exoskeleton") for path in sorted((CONF / group).glob("*.yaml"))]
HYSTERESIS = {"name": "hysteresis", "muscles": None, "share": 0.03, "width": 0.02}
FRICTION = {"name": "coulomb_friction", "torque_nm": 1.0, "sliding_rad_per_s": 0.1}


@pytest.mark.parametrize("path", FILES, ids=lambda path: f"{path.parent.name}/{path.stem}")
def test_every_value_has_a_comment_and_every_number_its_unit_and_source(path):
    lines = path.read_text().splitlines()
    assert lines[0].startswith("#")
    values = [line for line in lines if re.match(r"\s*(- )?\w+: \S", line)]
    assert [line for line in values if "#" not in line and "_target_" not in line] == []
    numbers = [line for line in values if re.search(r": -?\d", line.split("#")[0])]
    assert [line for line in numbers if not re.search(r"# .+ \(.+\); .+", line)] == []


@pytest.mark.parametrize(
    ("effect", "message"),
    [
        ({"name": "hysterisis", "muscles": None}, "unknown effect 'hysterisis': did you mean 'hysteresis'?"),
        (HYSTERESIS | {"shares": 1.0}, "effect hysteresis has no parameter 'shares': did you mean 'share'?"),
        (HYSTERESIS | {"share": 0.5}, "effect hysteresis, share: expected a number from 0.0 to 0.3, got 0.5"),
        (
            FRICTION | {"joints": None, "torque_nm": 99.0},
            "effect coulomb_friction, torque_nm: expected a number from 0.0 to 10.0 N m, got 99.0; change it in",
        ),
        (HYSTERESIS | {"share": "a lot"}, "expected a number from 0.0 to 0.3, got 'a lot'"),
        (HYSTERESIS | {"share": float("nan")}, "expected a number from 0.0 to 0.3, got nan"),
        (
            {"name": "hysteresis", "muscles": None, "share": 0.1},
            "missing parameter 'width' (contraction over which the widest element turns)",
        ),
        ({"name": "hysteresis", "share": 0.1, "width": 0.1}, "effect hysteresis: missing key 'muscles'"),
        (HYSTERESIS | {"joints": ["SFE"]}, "effect hysteresis acts at the muscle: choose muscles, not joints"),
        ({"muscles": None}, "an effect needs a name"),
        (HYSTERESIS | {"form": "bouc-wen"}, "effect hysteresis has no form 'bouc-wen': did you mean 'bouc_wen'?"),
        (
            {"name": "coulomb_friction", "form": "cable", "joints": None, "share": 0.1, "sliding_per_s": 0.02},
            "effect coulomb_friction: missing key 'muscles'",
        ),
        (HYSTERESIS | {"form": "regulator"}, "effect hysteresis has no parameter 'share'"),
        (
            {"name": "cubic_stiffness", "form": "duffing", "muscles": None, "share": 0.2},
            "acts at the motion, not at a muscle or joint",
        ),
    ],
)
def test_a_wrong_effect_is_named_with_the_remedy(effect, message):
    with pytest.raises(ValidationError, match=re.escape(message)):
        with_effects(configured().plant, effect)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda v: v["effects"].append(HYSTERESIS | {"muscles": ["pam7"]}),
            r"plant.effects.0.muscles: effect hysteresis: no muscle 'pam7'; did you mean 'pam\d'\?",
        ),
        (
            lambda v: v["effects"].extend([FRICTION | {"joints": None}, FRICTION | {"joints": ["EFE"]}]),
            "coulomb_friction is listed twice for joint EFE",
        ),
        (lambda v: v["muscles"].pop("MAS-10"), "no constants for muscle pam2 or its type MAS-10"),
    ],
)
def test_what_does_not_fit_the_machine_is_refused(change, message):
    values = configured().plant.model_dump()
    change(values)
    with pytest.raises(ValueError, match=message):
        Plant.model_validate(values).check_against(configured().exoskeleton)


def test_a_plant_survives_writing_and_reading():
    plant = configured("rich").plant
    assert Plant.model_validate(plant.model_dump()) == plant
    assert plant.model_dump()["effects"][0] == {"name": "hysteresis", "muscles": None, "share": 0.05, "width": 0.02}


def test_a_muscles_own_constants_come_before_its_types():
    machine, values = configured().exoskeleton, configured().plant.model_dump()
    values["muscles"]["pam3"] = values["muscles"]["MAS-40"] | {"damping_n_s": 1.0}
    plant = Plant.model_validate(values)
    assert [plant.find_model(muscle.name, muscle.type).damping_n_s for muscle in machine.muscles] == [
        90.0,
        7.5,
        1.0,
        7.5,
    ]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda v: v["muscles"][0].update(joint="SFF"), "muscle pam1: no joint 'SFF'; did you mean 'SFE'?"),
        (lambda v: v["muscles"][1].update(name="pam1"), "muscle 'pam1' is listed twice"),
        (lambda v: v["joints"][0].update(lower_rad=2.0), "joint SFE: expected lower_rad < upper_rad"),
        (lambda v: v["muscles"][0].update(sign=0), "sign"),
        (lambda v: v.update(colour="red"), "colour"),
        (
            lambda v: v["muscles"][0].update(moment_arm_m=100.0),
            "muscle pam1: expected contractions between -0.1 and 0.4 over the range of joint SFE, got -15.6 to 422; "
            "lower moment_arm_m",
        ),
        (lambda v: v["joints"][0].update(upper_rad=4.0), "joints.0.upper_rad"),
        (lambda v: v["velocity_filter"].update(order=13), "velocity_filter.order: expected less than the 13 samples"),
        (lambda v: v["muscles"][0].update(max_pressure_kpa=1001.0), "muscles.0.max_pressure_kpa"),
    ],
)
def test_a_wrong_machine_is_refused(change, message):
    values = configured().exoskeleton.model_dump()
    change(values)
    with pytest.raises(ValidationError, match=re.escape(message)):
        Exoskeleton.model_validate(values)
