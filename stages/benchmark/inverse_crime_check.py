"""Whether a rig hides what the library would write itself: what the best form leaves of each effect, without noise.

In: a rig of whole sessions. Out, in parts, one an effect: `inverse_crime_check`, the residual that each form of the
true name leaves of the effect's own change beyond the nominal constants. Where next to nothing is left, both simulate
the same equations, and naming the effect proves little; unless there is but one way to write it.
"""

from collections.abc import Mapping
from functools import partial
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
from stages.science.recording.datasets import tabulate_session
from stages.science.scorecard.judgement import explain_exactly

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
    tables = ctx.land_each("effects", partial(_compare, cfg, ctx), {each["key"]: (each,) for each in told})
    return tables[INVERSE_CRIME_CHECK.name]


def _compare(cfg: Config, ctx: Context, told: Mapping[str, Any]) -> dict[str, pd.DataFrame]:
    """Return a row for each form of the true name that acts in an effect's channel."""
    key, name, only_form = str(told["key"]), str(told["name"]), bool(told["only_form"])
    sessions = ctx.device.record_quietly(key)
    channel = sessions[0].truth["effects"][0]["channel"]
    tables = [tabulate_session(session.samples, session.meta, key) for session in sessions]
    pairs = [
        pair
        for pair in zip(*(build_muscle_channels(each, cfg.discrepancy) for each in tables), strict=True)
        if pair[0].channel == channel
    ]
    rows = []
    for form in [form for form in pairs[0][0].forms if form.name == name]:
        sizes = np.array([explain_exactly(form, *pair) for pair in pairs])
        effect, left = (float(each) for each in np.sqrt((sizes**2).mean(axis=0)))
        row = {"key": key, "name": name, "form": form.form, "channel": channel, "only_form": only_form}
        rows.append({**row, "effect": effect, "left": left, "share": left / effect if effect > 0.0 else 0.0})
    found = pd.DataFrame(rows, columns=list(INVERSE_CRIME_CHECK.columns))
    best = found["share"] == found["share"].min()
    same = best & (found["share"] < cfg.inverse_crime_check.least_share) & (not only_form)
    return {INVERSE_CRIME_CHECK.name: found.assign(best=best, same_code=same)}
