"""Devices that `measuring` may ask: one real, which says what stands in a file, and one that is simulated."""

from pathlib import Path
from typing import ClassVar

from pipeline.config import Section


class Simulated(Section):
    real: ClassVar[bool] = False

    def read(self) -> float:
        return 1.0


class Real(Section):
    real: ClassVar[bool] = True

    file: str

    def read(self) -> float:
        return float(Path(self.file).read_text())
