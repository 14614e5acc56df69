"""Whether a rig hides what the library would write itself: what the best form leaves of each effect, without noise.

In: a rig of whole sessions. Out, in parts, one an effect: `inverse_crime_check`, the residual that each form of the
true name leaves of the effect's own change beyond the nominal constants. Where next to nothing is left, both simulate
the same equations, and naming the effect proves little; unless there is but one way to write it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
import pandas as pd
from pydantic import Field

from pipeline.config import Section, Target
from pipeline.context import Context
from pipeline.stage import stage
from pipeline.table import Table, column
from stages.science.discrepancy.muscle_dataset import build_muscle_channels
from stages.science.discrepancy.settings import DiscrepancySettings
from stages.science.output_channels.output_channel import EffectForm, OutputChannel
from stages.science.recording.datasets import tabulate_session
from stages.science.scorecard.exactness import explain_exactly

INVERSE_CRIME_CHECK = Table(
    "inverse_crime_check",
    "A form of the library on an effect of the rig, without noise",
    {
        "key": column(str, "of the effect on the rig"),
        "name": column(str, "of the effect"),
        "form": column(str, "of the library"),
        "channel": column(str, "in which it shows"),
        "effect": column(float, "its change beyond what the constants imitate, RMS over range", low=0),
        "left": column(float, "what the form leaves of that", low=0),
        "share": column(float, "the latter over the former", low=0),
        "best": column(bool, "whether it leaves least of all forms"),
        "only_form": column(bool, "whether the effect can be written in one way only"),
        "same_code": column(bool, "whether so little is left that both are the same equations, and need not be"),
    },
    key=("key", "form"),
    brief=("key", "form", "effect", "share", "best", "only_form", "same_code"),
)


class InverseCrimeCheck(Section):
    """Config group ``inverse_crime_check``."""

    effects: Annotated[list[str], Field(min_length=1)] | None
    least_share: Annotated[float, Field(gt=0.0, lt=1.0)]


class Config(Section):
    """What this stage reads."""

    rig: Target
    discrepancy: DiscrepancySettings
    inverse_crime_check: InverseCrimeCheck


@stage(INVERSE_CRIME_CHECK)
def inverse_crime_check(cfg: Config, ctx: Context) -> pd.DataFrame:
    """Fit every form of its true name to each effect without noise."""
    chosen = cfg.inverse_crime_check.effects
    told = [each for each in ctx.device.effects() if not each["outsider"] and (chosen is None or each["key"] in chosen)]
    jobs = [Job(cfg, ctx, str(each["key"]), str(each["name"]), bool(each["only_form"])) for each in told]
    with ctx.progress("effects", len(jobs)) as advance:
        for job, key in zip(jobs, ctx.spread(Job.run, jobs), strict=True):
            ctx.record.include([key])
            advance(job.key)
    return ctx.record.collect()[INVERSE_CRIME_CHECK.name]


@dataclass(frozen=True, eq=False)
class Job:
    """One effect of the rig."""

    cfg: Config
    ctx: Context
    key: str
    name: str
    only_form: bool

    def run(self) -> str:
        """Fit the forms, land the part and return its name."""
        self.ctx.record.part((self.key,), lambda: {INVERSE_CRIME_CHECK.name: self.compare()})
        return self.ctx.record.name((self.key,))

    def compare(self) -> pd.DataFrame:
        """Return a row for each form of the true name that acts in the effect's channel."""
        with_it, without = self.ctx.device.record_quietly(self.key)
        channel = with_it.truth["effects"][0]["channel"]
        pairs = list(zip(self.build(with_it, channel), self.build(without, channel), strict=True))
        rows = [self.measure(form, pairs) for form in pairs[0][0].forms if form.name == self.name]
        found = pd.DataFrame(rows, columns=list(INVERSE_CRIME_CHECK.columns))
        if found.empty:
            return found
        best = found["share"] == found["share"].min()
        same = best & (found["share"] < self.cfg.inverse_crime_check.least_share) & (not self.only_form)
        return found.assign(best=best, same_code=same)

    def build(self, session: Any, channel: str) -> list[OutputChannel]:
        """Return the outputs of one channel."""
        tables = tabulate_session(session.samples, session.meta, self.key)
        outputs = build_muscle_channels(tables, self.cfg.discrepancy)
        return [output for output in outputs if output.channel == channel]

    def measure(self, form: EffectForm, pairs: Sequence[tuple[OutputChannel, OutputChannel]]) -> dict[str, Any]:
        """Return the row of one form, root mean squares over muscles."""
        sizes = np.array([explain_exactly(form, *pair) for pair in pairs])
        effect, left = (float(each) for each in np.sqrt((sizes**2).mean(axis=0)))
        return {
            "key": self.key,
            "name": self.name,
            "form": form.form,
            "channel": pairs[0][0].channel,
            "effect": effect,
            "left": left,
            "share": left / effect if effect > 0.0 else 0.0,
            "only_form": self.only_form,
        }
