"""Tries: writes `tried`, and in a file that the environment names, each seed with which it was begun and ended."""

import os
import signal
import time
from pathlib import Path

import pandas as pd

from pipeline.config import Section
from pipeline.stage import stage
from pipeline.table import Table, column

TRIED = Table("tried", "A try", {"seed": column(int, "seed"), "score": column(float, "how well it went", unit="m")})


class Trying(Section):
    pause_s: float
    busy_s: float
    fail_at: list[int]
    die_at: list[int]


class Config(Section):
    trying: Trying
    seed: int


@stage(TRIED)
def trying(cfg: Config, numbers, ctx) -> pd.DataFrame:
    """Try once."""
    log(f"begun {cfg.seed}")
    time.sleep(cfg.trying.pause_s)
    mended = os.environ.get("TOY_MENDED") == "yes"
    if cfg.seed in cfg.trying.fail_at and not mended:
        raise ArithmeticError(f"cannot try {cfg.seed}")
    if cfg.seed in cfg.trying.die_at and not mended:
        os.kill(os.getpid(), signal.SIGKILL)
    end = time.process_time() + cfg.trying.busy_s
    while time.process_time() < end:
        pass
    log(f"ended {cfg.seed}")
    return pd.DataFrame({"seed": [cfg.seed], "score": [numbers["draw"].mean() + cfg.seed]})


def log(line: str) -> None:
    """Append a line, whole, where the environment says."""
    if "TOY_LOG" in os.environ:
        with Path(os.environ["TOY_LOG"]).open("a") as handle:
            handle.write(f"{line}\n")
