"""What a stage works with outside of this program: a device, and the interface through which people follow it.

A stage names the section that configures its device (a field of type `pipeline.config.Target`); the key ``interface``
names the section that configures the interface. A device with the attribute ``real`` set measures what cannot be made
again: its tables are kept, and its stages spread no work over processes.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol, runtime_checkable


@runtime_checkable
class ConnectableDevice(Protocol):
    """A device that people can follow through an interface."""

    def connect_interface(self, connection: Any) -> None:
        """Take what the interface returned when it was opened; raise an error if this device has no use for it."""


class Interface(Protocol):
    """What people follow devices through, the same for all stages of a run."""

    @property
    def greeting(self) -> Sequence[str]:
        """Lines that say how to use it, once it is open."""

    def open(self) -> Any:
        """Return what devices are connected to."""

    def close(self) -> None:
        """End it; harmless when it is not open."""
