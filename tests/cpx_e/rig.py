"""The rig on an emulated device: as the real one, but that the emulated person is told of each trial.

The configuration of rig=festo_cpx flows in, with the port by which the emulator is told; trials flow out to it.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing.connection import Client
from typing import Any

import pytest
from omegaconf import OmegaConf
from pydantic import TypeAdapter

from stages.science.rig.festo.festo_cpx import FestoCpx
from stages.science.rig.trial import Trial
from tests.composing import compose_values
from tests.cpx_e.emulator import ask
from tests.cpx_e.turned import TurnedEmulator, emulate
from tests.science.plant.machines import configured


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
            here[self.control_port].ask("trial", **request)
            return
        with Client(("127.0.0.1", self.control_port)) as control:
            ask(control, "trial", **request)


def describe_rig(*overrides: str, rig: str = "festo_cpx") -> dict[str, Any]:
    """Return the section of a rig's option under overrides, as plain values, on this computer."""
    section: dict[str, Any] = OmegaConf.to_container(compose_values(f"rig={rig}", *overrides)["rig"], resolve=True)
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


@contextmanager
def emulate_rig(*overrides: str, rig: str = "festo_cpx") -> Iterator[tuple[TurnedEmulator, FestoCpx]]:
    """Go by a clock that is turned, with an emulated device and the rig on it."""
    pytest.importorskip("cpx_io", reason="festo-cpx-io is not installed")
    section = describe_rig(*overrides, rig=rig)
    with emulate(describe_machine(section)) as emulator:
        yield emulator, build_rig(section, emulator.port, emulator.control_port)
