"""Doubles: reads `numbers`, writes `doubles` and `halves` in parts, slowly if asked."""

import os
import signal
import time

import pandas as pd

from pipeline.config import Section
from pipeline.stage import stage
from pipeline.table import Table, column

DOUBLES = Table(
    "doubles",
    "A doubled number",
    {"number": column(int, "from numbers"), "double": column(float, "twice the draw")},
    key=("number",),
)
HALVES = Table(
    "halves",
    "A halved number",
    {"number": column(int, "from numbers"), "half": column(float, "half the draw")},
    key=("number",),
)


class Doubling(Section):
    pause_s: float
    fail_at: int | None
    kill_at: int | None
    interrupt_at: int | None
    terminate_at: int | None


class Config(Section):
    doubling: Doubling


@stage(DOUBLES, HALVES)
def doubling(cfg: Config, numbers, ctx):
    """Double and halve each number, one part each."""
    signals = {
        cfg.doubling.kill_at: signal.SIGKILL,
        cfg.doubling.interrupt_at: signal.SIGINT,
        cfg.doubling.terminate_at: signal.SIGTERM,
    }
    with ctx.progress("doubling", len(numbers)) as advance:
        for number, draw in zip(numbers["number"], numbers["draw"], strict=True):

            def make(number=number, draw=draw):
                if number == cfg.doubling.fail_at:
                    raise ArithmeticError(f"cannot double {number}")
                if number in signals and not ctx.record.has("mark", number):
                    os.kill(os.getpid(), signals[number])
                    time.sleep(5)
                time.sleep(cfg.doubling.pause_s)
                return {
                    "doubles": pd.DataFrame({"number": [number], "double": [2 * draw]}),
                    "halves": pd.DataFrame({"number": [number], "half": [draw / 2]}),
                }

            ctx.record.part((number,), make)
            advance(f"number {number}")
    return ctx.record.collect()
