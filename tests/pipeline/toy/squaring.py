"""Squares: writes `squares` in parts, spread over processes, slowly or wrongly if asked."""

import os
import signal
import time
from functools import partial

import pandas as pd

from pipeline.config import Section
from pipeline.stage import stage
from pipeline.table import Table, column

SQUARES = Table(
    "squares",
    "A squared number",
    {
        "number": column(int, "from zero"),
        "square": column(float, "its square, and a random part"),
    },
    ("number",),
)


class Squaring(Section):
    count: int
    pause_s: float
    fail_at: int | None
    die_at: int | None


class Config(Section):
    squaring: Squaring
    seed: int


@stage(SQUARES, stream="squaring")
def squaring(cfg: Config, ctx):
    """Square each number, wherever there is a worker."""
    numbers = range(cfg.squaring.count)
    with ctx.progress("squaring", len(numbers)) as advance:
        for key in ctx.spread(partial(land, cfg, ctx), numbers):
            ctx.record.include([key])
            advance(key)
    return ctx.record.collect()


def land(cfg: Config, ctx, number):
    """Land one number's part."""
    ctx.record.part((number,), partial(square, cfg, ctx, number))
    return ctx.record.name((number,))


def square(cfg: Config, ctx, number):
    """Square one number."""
    time.sleep(cfg.squaring.pause_s)
    died = ctx.folder / "died"
    if number == cfg.squaring.die_at and not died.exists():
        died.write_text("")
        os.kill(os.getpid(), signal.SIGKILL)
    if number == cfg.squaring.fail_at:
        raise ArithmeticError(f"cannot square {number}")
    return {"squares": pd.DataFrame({"number": [number], "square": [number**2 + ctx.generator(number).random()]})}
