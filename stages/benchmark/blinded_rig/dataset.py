"""Writes a measured dataset, and the truth sealed beside it.

Flows in: a scenario, a folder. Flows out: ``FOLDER/samples.parquet``, ``FOLDER/meta.json`` and, outside the folder,
``FOLDER.truth.json``. The folder appears whole or not at all.
"""

import json
import os
import shutil
import tempfile
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from threadpoolctl import threadpool_limits

from stages.benchmark.blinded_rig.calibration import CHANNELS, NominalFit, Size, size_effect
from stages.benchmark.blinded_rig.chain import Carried, Readings
from stages.benchmark.blinded_rig.effects import ALL_EFFECTS
from stages.benchmark.blinded_rig.machine import (
    BRAID_ANGLE_DEG,
    CONTRACTION_FACTOR,
    DATA_SHEET,
    JOINT_OF_MUSCLE,
    MUSCLES,
    VALVE_TAU_S,
    Array,
)
from stages.benchmark.blinded_rig.scenarios import Scenario
from stages.benchmark.blinded_rig.session import TRIAL_S, Session, build_session, observe, prescribe
from stages.benchmark.blinded_rig.surroundings import SEED_OFFSET, Surroundings

TIMING = "command u[k] is held over [t_k, t_k+1); sensors sample at t_k, before u[k] acts"
PAUSE_S = 30.0
"""From the start of one further trial to that of the next."""
GEOMETRY = "eps0 + sign*r/L0*joint_angle (constant moment arm)"


@dataclass(frozen=True)
class Dataset:
    """What is handed over, and what is sealed."""

    samples: pd.DataFrame
    meta: dict[str, Any]
    truth: dict[str, Any]


def simulate(scenario: Scenario) -> Dataset:
    """Simulate the dataset of a scenario; sizes are set on noisy data even where ``noisy`` is false."""
    refuse_nonsense(scenario)
    with threadpool_limits(1, user_api="blas"):
        return simulate_possible(scenario)


def simulate_possible(scenario: Scenario) -> Dataset:
    """Simulate the dataset of a scenario that makes sense."""
    fit, sizes, carried = size_effects(scenario)
    session = fit.session
    noisy = observe(session, carried)
    quiet = session
    if not scenario.noisy or session.surroundings is not None:
        quiet = build_session(
            scenario.seed, scenario.trials, scenario.load_cell_site, noisy=False, catalogue=scenario.catalogue
        )
    shown = session if scenario.noisy else quiet
    readings = noisy if scenario.noisy else observe(shown, carried)
    truth = seal(scenario, fit, sizes, noisy)
    if session.surroundings is not None:
        truth |= seal_surroundings(session.surroundings, NominalFit(quiet))
    return Dataset(tabulate(shown.as_read(readings), readings), describe(shown), truth)


def size_effects(scenario: Scenario) -> tuple[NominalFit, dict[str, Size], Carried]:
    """Return the nominal fit of a scenario's session, the sizes of its effects there by key, and both as carried."""
    session = build_session(scenario.seed, scenario.trials, scenario.load_cell_site, catalogue=scenario.catalogue)
    fit = NominalFit(session)
    carries = np.array([float(muscle in scenario.muscles) for muscle in MUSCLES])
    sizes = {key: size_effect(fit, ALL_EFFECTS[key], carries, scenario.magnitude) for key in scenario.effects}
    return fit, sizes, tuple((ALL_EFFECTS[key], sized.size) for key, sized in sizes.items())


def extend(
    scenario: Scenario, command_kpa: Array, joint_rad: Array, step_s: float, taken: int
) -> tuple[pd.DataFrame, list[float]]:
    """Return rows of further trials of a scenario's session, and when they start, s.

    Commands (4, J, n), kPa, and angles (2, J, n), rad, are given every `step_s`; `taken` of further trials were
    recorded before. The machine is the session's, and what it hides is as large as there.
    """
    with threadpool_limits(1, user_api="blas"):
        fit, _, carried = size_effects(scenario)
        session = fit.session
        first_s = PAUSE_S * taken
        begun = replace(session, stimulus=replace(session.stimulus, start_s=session.stimulus.start_s + first_s))
        further = prescribe(
            begun, scenario.seed + SEED_OFFSET[scenario.catalogue], command_kpa, joint_rad, step_s, PAUSE_S
        )
        readings = observe(further, carried)
    rows = tabulate(further.as_read(readings), readings)
    return rows.assign(trial=rows["trial"] + scenario.trials + taken), further.stimulus.start_s.tolist()


def seal_surroundings(around: Surroundings, quiet: NominalFit) -> dict[str, Any]:
    """Tell what a foreign session is set in, and the share of full force that the textbook misses without noise."""
    missed = quiet.floor["force_n"] / quiet.session.machine.full_force_n
    return {"surroundings": asdict(around), "textbook_misses_share": by_muscle(missed)}


def refuse_nonsense(scenario: Scenario) -> None:
    """One line for what cannot be simulated.

    Raises
    ------
    ValueError
        Unknown effect or muscle, two effects that both replace the valve, fewer than one trial, a negative seed.
    """
    for kind, asked, known in (("effect", scenario.effects, ALL_EFFECTS), ("muscle", scenario.muscles, MUSCLES)):
        unknown = [each for each in asked if each not in known]
        if unknown:
            raise ValueError(f"unknown {kind} {unknown[0]!r}; there are: {', '.join(known)}")
    if sum(ALL_EFFECTS[key].site == "valve" for key in scenario.effects) > 1:
        raise ValueError(f"{' and '.join(scenario.effects)} both replace the valve: hide one of them")
    if scenario.trials < 1 or scenario.seed < 0 or not scenario.muscles:
        raise ValueError(f"need a trial, a muscle and a seed of at least 0, not {scenario}")


def tabulate(session: Session, readings: Readings) -> pd.DataFrame:
    """One row per (trial, time, muscle)."""
    command = session.stimulus.command_kpa
    muscles, trials, samples = command.shape
    columns = {
        "pressure_command_kpa": command,
        "pressure_kpa": readings.pressure_kpa,
        "contraction": session.contraction,
        "contraction_velocity_per_s": session.contraction_velocity_per_s,
        "force_n": readings.force_n,
        "joint_angle_rad": session.joint_rad[JOINT_OF_MUSCLE],
        "joint_velocity_rad_per_s": session.joint_rad_per_s[JOINT_OF_MUSCLE],
    }
    return pd.DataFrame(
        {
            "trial": np.repeat(np.arange(trials, dtype=np.int64), samples * muscles),
            "time_s": np.tile(np.repeat(np.arange(samples) / session.rate_hz, muscles), trials),
            "muscle": np.tile(np.array(MUSCLES, dtype=object), trials * samples),
            **{name: np.moveaxis(values, 0, -1).ravel() for name, values in columns.items()},
        }
    )


def describe(session: Session) -> dict[str, Any]:
    """``meta.json``: what a user would know."""
    sheets = {muscle: asdict(sheet) for muscle, sheet in DATA_SHEET.items()}
    damping = {muscle: sheet.pop("damping_n_s") for muscle, sheet in sheets.items()}
    return {
        "sampling_rate_hz": session.rate_hz,
        "trial_s": TRIAL_S,
        "trials": session.stimulus.start_s.size,
        "trial_start_s": session.stimulus.start_s.tolist(),
        "timing": TIMING,
        "load_cell_site": session.load_cell_site,
        "contraction_column": GEOMETRY,
        "muscles": sheets,
        "nominal": {
            "valve_tau_s": VALVE_TAU_S,
            "braid_angle_deg": BRAID_ANGLE_DEG,
            "contraction_factor": CONTRACTION_FACTOR,
            "damping_n_s": damping,
        },
        "description": "2-DoF upper-limb exoskeleton, a person moving the joints, commanded PAM pressures",
    }


def seal(scenario: Scenario, fit: NominalFit, sizes: dict[str, Size], readings: Readings) -> dict[str, Any]:
    """``truth.json``: the scenario, what is hidden and how large, floors, gaps and the machine's true constants."""
    machine = {name: np.asarray(value).tolist() for name, value in vars(fit.session.machine).items() if name != "law"}
    machine = {name: value for name, value in machine.items() if "filter" not in name}
    asked = {name: value for name, value in asdict(scenario).items() if (name, value) != ("catalogue", "own")}
    return {
        "scenario": asked,
        "name": scenario.name,
        "effects": [tell(key, sized, scenario.muscles) for key, sized in sizes.items()],
        "floor": {channel: by_muscle(fit.floor[channel]) for channel in CHANNELS},
        "gap_over_floor": {channel: by_muscle(fit.ratio(readings, channel)) for channel in CHANNELS},
        "machine": machine,
    }


def tell(key: str, sized: Size, muscles: tuple[str, ...]) -> dict[str, Any]:
    """One hidden effect; its numbers for the muscles that carry it."""
    effect = ALL_EFFECTS[key]
    facts = {
        name: getattr(effect, name) for name in ("key", "name", "site", "channel", "unit", "only_form", "outsider")
    }
    numbers = {"size": sized.size, "gap_over_floor": sized.ratio, "absorbed_share": sized.absorbed}
    told = {name: {m: by_muscle(values)[m] for m in muscles} for name, values in numbers.items()}
    return {**facts, "muscles": list(muscles), **told, "reached": sized.reached}


def by_muscle(values: Array) -> dict[str, float]:
    """(4,) by muscle."""
    return dict(zip(MUSCLES, map(float, values), strict=True))


def write(dataset: Dataset, folder: Path) -> None:
    """Write the folder, then the seal beside it.

    Raises
    ------
    FileExistsError
        The folder or the seal is there already: nothing is written over.
    """
    sealed = folder.parent / f"{folder.name}.truth.json"
    for path in (folder, sealed):
        if path.exists():
            raise FileExistsError(f"{path} is there already: nothing is written over")
    folder.parent.mkdir(parents=True, exist_ok=True)
    made = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", dir=folder.parent))
    try:
        dataset.samples.to_parquet(made / "samples.parquet", index=False)
        (made / "meta.json").write_text(json.dumps(dataset.meta, indent=1) + "\n")
        (made / "truth").write_text(json.dumps(dataset.truth, indent=1) + "\n")
        os.replace(made / "truth", sealed)
        made.chmod(0o755)
        os.replace(made, folder)
    except BaseException:
        shutil.rmtree(made, ignore_errors=True)
        raise
