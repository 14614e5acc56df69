"""Draws the trials of the automatic identification protocol: nobody moves, the antagonist provides the external force.

Out: `protocol_commands`, which `hardware` executes. The paper's linear model comes from such data (Teramae, Noda, Hyon
and Morimoto 2013; its appendix D), as many trials for each experiment as the interaction design has.
"""

from typing import ClassVar, Self

import numpy as np
import pandas as pd
from pydantic import PositiveInt, model_validator

from pipeline.config import Section, View
from pipeline.context import Context
from pipeline.stage import stage
from pipeline.table import Table, column
from stages.science.figures.trial_commands import draw_protocol
from stages.science.plant.exoskeleton import Exoskeleton
from stages.science.rig.contract import MEASUREMENT_COLUMNS, MOST_ROWS
from stages.science.rig.excitation import RigWithLimits, check_levels
from stages.science.rig.passive_trials import Sweeps

PROTOCOL_COMMANDS = Table(
    "protocol_commands",
    "A sample of a muscle's command in a trial in which nobody moves",
    {
        "experiment": column(int, "sequence of trials", low=1),
        "trial": column(int, "trial of this experiment", low=1),
        "time_s": MEASUREMENT_COLUMNS["time_s"],
        "muscle": MEASUREMENT_COLUMNS["muscle"],
        "pressure_command_kpa": column(float, "gauge pressure asked for", unit="kPa", low=0.0, high=1000.0),
    },
    key=("experiment", "trial", "muscle", "time_s"),
)


class Protocol(Sweeps):
    """Config group ``protocol``."""

    experiments: PositiveInt
    trials: PositiveInt


class CommandsWithinLimits(View):
    """Every pressure that may be commanded is one that the rig applies, as fast as it is asked to."""

    protocol: Protocol
    exoskeleton: Exoskeleton
    rig: RigWithLimits

    @model_validator(mode="after")
    def _keep_limits(self) -> Self:
        check_levels(self.protocol.range_kpa, self.exoskeleton, self.rig.limits, "protocol.range_kpa")
        self.protocol.check_rates(self.exoskeleton, self.rig.limits, "protocol")
        return self


class Config(Section):
    """What this stage reads."""

    checks: ClassVar = (CommandsWithinLimits,)

    protocol: Protocol
    exoskeleton: Exoskeleton
    seed: int

    @model_validator(mode="after")
    def _fit_machine(self) -> Self:
        self.protocol.check_against(self.exoskeleton, "protocol")
        most = MOST_ROWS // (self.protocol.trials * self.exoskeleton.samples * len(self.exoskeleton.muscles))
        if self.protocol.experiments > most:
            raise ValueError(
                f"protocol.experiments: expected at most {most} of {self.protocol.trials} trials, as {MOST_ROWS} rows "
                f"still fit in memory, got {self.protocol.experiments}; lower it, protocol.trials, exoskeleton.trial_s "
                "or exoskeleton.sampling_rate_hz"
            )
        return self


@stage(PROTOCOL_COMMANDS, stream="protocol")
def protocol(cfg: Config, ctx: Context) -> pd.DataFrame:
    """Draw the commands of every experiment's passive trials."""
    exoskeleton, trials = cfg.exoskeleton, cfg.protocol.trials
    samples, muscles = exoskeleton.samples, exoskeleton.muscle_names
    # trial after trial, in each all of a muscle, then the next
    keys = {
        "trial": np.repeat(np.arange(1, trials + 1), samples * len(muscles)),
        "time_s": np.tile(np.arange(samples) / exoskeleton.sampling_rate_hz, trials * len(muscles)),
        "muscle": np.tile(np.repeat(np.array(muscles, dtype=object), samples), trials),
    }
    frames = []
    for experiment in range(1, cfg.protocol.experiments + 1):
        commands = cfg.protocol.draw(exoskeleton, trials, ctx.generator(experiment))
        in_rows = commands.transpose(0, 2, 1).ravel()
        frames.append(pd.DataFrame({"experiment": experiment, **keys, "pressure_command_kpa": in_rows}))
    table = pd.concat(frames, ignore_index=True)
    caption = (
        f"Commands of the automatic protocol's first experiment, in which nobody moves: {trials} trials "
        f"of {exoskeleton.trial_s:g} s, agonist and antagonist swept in turn while the other one holds levels."
    )
    ctx.figure("protocol", draw_protocol(table[table["experiment"] == 1], exoskeleton.muscles_by_joint), caption)
    return table
