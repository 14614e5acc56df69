"""The configured machine with a CPX-E, as MACHINE.json describes it."""

from __future__ import annotations

from typing import Any

from tests.plant.machines import configured

MODULES = ["EP", "4AO", "4AI", "4AI", "1CI", "1CI"]


def describe(plant: str = "nominal", rate: float = 100.0, trial_s: float = 2.0, **changed: Any) -> dict[str, Any]:
    """Return a machine with two joints and four muscles; `changed` replaces whole sections."""
    rig = configured(plant)
    told = rig.model_dump(include={"exoskeleton", "plant", "participants", "experimenter", "movement"})
    told["exoskeleton"] |= {"sampling_rate_hz": rate, "trial_s": trial_s}
    told["device"] = {"host": "127.0.0.1", "port": 0, "watchdog_s": 0.2, "reply_s": 0.1, "modules": MODULES}
    pressure = {"kpa_per_count": 0.04, "zero_count": 0.0, "sign": 1}
    force = {"n_per_count": 0.2, "zero_count": 0.0, "sign": 1}
    told["channels"] = {
        name: {
            "command": {"module": 1, "channel": channel, **pressure},
            "pressure": {"module": 2, "channel": channel, **pressure},
            "force": {"module": 3, "channel": channel, **force},
        }
        for channel, name in enumerate(rig.exoskeleton.muscle_names)
    }
    told["encoders"] = {
        name: {"module": 4 + place, "rad_per_count": 0.000628, "zero_count": 0, "sign": 1}
        for place, name in enumerate(rig.exoskeleton.joint_names)
    }
    return told | {"seed": 1, "port": 0} | changed
