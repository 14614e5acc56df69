"""The rig on an emulated device: as the real one, but that the emulated person is told of each trial.

The configuration of rig=festo_cpx flows in, with the port by which the emulator is told; trials flow out to it.
"""

from __future__ import annotations

import functools
import hashlib
import json
from multiprocessing.connection import Client
from pathlib import Path
from typing import Any

from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf
from pydantic import TypeAdapter

from stages.science.rig.festo.festo_cpx import FestoCpx
from stages.science.rig.trial import Trial
from tests.cpx_e.emulator import ask
from tests.cpx_e.turned import TurnedEmulator
from tests.science.plant.machines import configured

CONF = Path(__file__).resolve().parents[2] / "conf"


class ToldFestoCpx(FestoCpx):
    """A rig whose person is emulated, and told of trials at the control port."""

    control_port: int

    def announce(self, trial: Trial) -> None:
        """Tell the emulated person."""
        content = hashlib.sha256(trial.label.encode() + trial.pressure_command_kpa.tobytes()).digest()
        request = {
            "kind": trial.kind,
            "participant": trial.participant,
            "reference_rad": trial.reference_rad,
            "samples": self.samples,
            "lead_samples": self._lead_samples,
            "seed": int.from_bytes(content[:4], "big"),
        }
        here = {each.control_port: each for each in TurnedEmulator.serving}
        if self.control_port in here:
            here[self.control_port].trial(**request)
            return
        with Client(("127.0.0.1", self.control_port)) as control:
            ask(control, "trial", **request)


@functools.cache
def _compose(overrides: tuple[str, ...]) -> dict[str, Any]:
    chosen = ["+exoskeleton=upper_limb", "+participant=both", "+rig=festo_cpx", *overrides]
    with initialize_config_dir(str(CONF), version_base="1.3"):
        values: dict[str, Any] = OmegaConf.to_container(compose(overrides=chosen), resolve=True)
    return values


def describe_rig(*overrides: str) -> dict[str, Any]:
    """Return the section of rig=festo_cpx under overrides, as plain values, on this computer."""
    section = json.loads(json.dumps(_compose(overrides)["rig"]))
    section.pop("_target_")
    section["device"]["host"] = "127.0.0.1"
    return section


def describe_machine(section: dict[str, Any]) -> dict[str, Any]:
    """Return what an emulator of a rig's device needs, with the people and the plant of rig=sim."""
    sim = configured().model_dump(mode="json")
    return {
        **{name: section[name] for name in ("exoskeleton", "participants", "device", "channels", "encoders")},
        **{name: sim[name] for name in ("plant", "experimenter", "movement")},
        "seed": 0,
    }


def build_rig(section: dict[str, Any], port: int, control_port: int | None = None) -> FestoCpx:
    """Build the rig of a section on an emulator's ports, as the pipeline would; told of trials where it can be."""
    values = section | {"device": section["device"] | {"port": port}}
    if control_port is None:
        return TypeAdapter(FestoCpx).validate_python(values)
    return TypeAdapter(ToldFestoCpx).validate_python(values | {"control_port": control_port})
