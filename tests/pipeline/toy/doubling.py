"""Doubles: reads `numbers`, writes `doubles` and `halves` in parts, slowly or wrongly if asked.

It pauses for somebody who comes between; not where the environment says that nobody does.
"""

import os
import signal
import time
from contextlib import suppress
from functools import partial
from typing import Literal

import pandas as pd

from pipeline.config import Section
from pipeline.stage import stage
from pipeline.table import Table, column

NUMBER = column(int, "from numbers")
DOUBLES = Table("doubles", "A doubled number", {"number": NUMBER, "double": column(float, "twice it")}, ("number",))
HALVES = Table("halves", "A halved number", {"number": NUMBER, "half": column(float, "half of it")}, ("number",))


def swallow(pause_s):
    """Lose whatever is raised meanwhile, as a callback of a library does."""
    with suppress(BaseException):
        time.sleep(pause_s)


def wrap(pause_s):
    """Raise something else, as compiled code does."""
    try:
        time.sleep(pause_s)
    except BaseException as error:
        raise SystemError("returned a result with an exception set") from error


PAUSES = {None: time.sleep, "swallow": swallow, "wrap": wrap}


class Doubling(Section):
    pause_s: float
    fail_at: int | None
    die_at: int | None
    digits: int
    deaf: Literal["swallow", "wrap"] | None


class Config(Section):
    doubling: Doubling


@stage(DOUBLES, HALVES)
def doubling(cfg: Config, numbers, ctx):
    """Double and halve each number, one part each, wherever there is a worker."""
    jobs = {str(row[0]): row for row in zip(numbers["number"], numbers["draw"], strict=True)}
    return ctx.land("doubling", partial(land, cfg.doubling, ctx), jobs)


def land(cfg: Doubling, ctx, *row):
    """Land one number's part."""
    ctx.record.part(row[:1], partial(double, cfg, ctx, *row))
    return [ctx.record.name(row[:1])]


def double(cfg: Doubling, ctx, number, draw):
    """Double and halve one number."""
    died = ctx.folder / "died"
    if number == cfg.die_at and not died.exists():
        died.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    if number == cfg.fail_at:
        raise ArithmeticError(f"cannot double {number}")
    if "TOY_UNDISTURBED" not in os.environ:
        PAUSES[cfg.deaf](cfg.pause_s)
    return {
        "doubles": pd.DataFrame({"number": [number], "double": [round(2 * draw, cfg.digits)]}),
        "halves": pd.DataFrame({"number": [number], "half": [round(draw / 2, cfg.digits)]}),
    }
