"""Machines for tests: the configured one, and others with other joints, muscles and rates."""

import functools
from pathlib import Path

import numpy as np
import yaml
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf
from pydantic import TypeAdapter
from scipy.integrate import solve_ivp

from stages.science.plant.effect import find_effect
from stages.science.plant.exoskeleton import Exoskeleton
from stages.science.plant.machine import read_machine
from stages.science.plant.plant import Plant
from stages.science.plant.record_plant import InitialState
from stages.science.rig.sim import SimulatedRig

CONF = Path(__file__).resolve().parents[3] / "conf"


@functools.cache
def configured(plant: str = "nominal") -> SimulatedRig:
    """The rig that `rig=sim` and `plant=...` describe, built as the pipeline builds it."""
    chosen = ["+exoskeleton=upper_limb", f"+plant={plant}", "+participant=both", "+rig=sim"]
    with initialize_config_dir(str(CONF), version_base="1.3"):
        values = OmegaConf.to_container(compose(overrides=chosen), resolve=True)
    section = {name: value for name, value in values["rig"].items() if name != "_target_"}
    return TypeAdapter(SimulatedRig).validate_python(section)


def with_effects(plant: Plant, *effects: dict) -> Plant:
    """The same constants with other effects."""
    return Plant.model_validate(plant.model_dump() | {"effects": list(effects)})


def other_machine(muscles_of_joint: list[int], rate: float, trial_s: float) -> Exoskeleton:
    """A machine with that many muscles on each joint, agonists and antagonists in turn."""
    base = configured().exoskeleton.model_dump()
    joints, muscles = [], []
    for j, count in enumerate(muscles_of_joint):
        joints.append(base["joints"][j % 2] | {"name": f"joint{j}"})
        for m in range(count):
            row = base["muscles"][2 * (j % 2) + m % 2]
            muscles.append(row | {"name": f"muscle{j}{m}", "joint": f"joint{j}"})
    changed = {"joints": joints, "muscles": muscles, "sampling_rate_hz": rate, "trial_s": trial_s}
    return Exoskeleton.model_validate(base | changed)


def other_rig(exoskeleton: Exoskeleton, plant: str = "nominal") -> SimulatedRig:
    """The configured people and limits around another machine; effects on named muscles are dropped."""
    values = configured(plant).model_dump()
    kept = [effect for effect in values["plant"]["effects"] if not effect.get("muscles")]
    values["plant"]["effects"] = kept
    return SimulatedRig.model_validate(values | {"exoskeleton": exoskeleton.model_dump()})


def read_plant(name: str = "static_map", **changes: object):
    """Return the machine of records that `plant=...` describes, with changes."""
    return read_machine({**yaml.safe_load((CONF / "plant" / f"{name}.yaml").read_text()), **changes})


def simulate(plant, signals, constants, effects=(), begun=None, step_s=0.01):
    """Return the output of a machine for one record; effects are (name, form, values)."""
    columns = plant.refine({name: np.asarray(each, dtype=float)[:, None] for name, each in signals.items()}, step_s)
    placed = [(find_effect(name, form), values) for name, form, values in effects]
    return plant.simulate(columns, step_s, np.zeros(1), constants, placed, begun)[:, 0]


def solve(rates, start, time):
    """Return the states at these times, by an adaptive integrator that meets every bend of the inputs."""
    step = 0.5 * (time[1] - time[0])
    return solve_ivp(rates, (time[0], time[-1]), start, t_eval=time, rtol=1e-8, atol=1e-10, max_step=step).y


def begin_surely(place: float, rate: float, error: float = 1e-6) -> InitialState:
    """Return the beginning of a record that shows a place and a rate."""
    return InitialState(*(np.array([each]) for each in (place, error, rate, error, error)))
