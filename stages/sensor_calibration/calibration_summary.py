"""What a calibration came to, in sentences: lines of channels flow in, what was found and what to do next flow out.

In: `calibration_lines`, `calibration_changes`. Out: `calibration_findings`, `calibration_advice`.
"""

from collections.abc import Iterator

import pandas as pd

from pipeline.config import Section
from pipeline.context import Context
from pipeline.stage import stage
from pipeline.table import sentences
from stages.science.rig.festo.known_points import split_name

CALIBRATION_FINDINGS = sentences("calibration_findings", "finding")
CALIBRATION_ADVICE = sentences("calibration_advice", "advice")


class Config(Section):
    """What this stage reads: tables alone."""


@stage(CALIBRATION_FINDINGS, CALIBRATION_ADVICE)
def calibration_summary(
    cfg: Config, ctx: Context, calibration_lines: pd.DataFrame, calibration_changes: pd.DataFrame
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Say which channels are calibrated, how well, and what has changed."""
    found = describe_lines(calibration_lines, calibration_changes)
    return pd.DataFrame({"sentence": [*found]}), pd.DataFrame({"sentence": [*advise(calibration_lines)]})


def describe_lines(lines: pd.DataFrame, changes: pd.DataFrame) -> Iterator[str]:
    """Yield how many channels have a line, how far points are from it by kind, and what is strange."""
    good, refused = _split(lines)
    text = f"{len(good)} of {len(lines)} channels are calibrated"
    kinds = good.groupby([split_name(each)[1] for each in good["channel"]], sort=False)
    worst = {kind: rows.sort_values("residual_largest").iloc[-1] for kind, rows in kinds}
    residuals = ", ".join(
        f"{row['residual_largest']:.2g} {row['unit']} of {kind} ({row['channel']}, {row['points']} points)"
        for kind, row in worst.items()
    )
    yield f"{text}. The point that lies farthest from its line is off by {residuals}." if residuals else f"{text}."
    strange = changes[changes["channel"].isin(good["channel"]) & ~changes["plausible"]]
    if len(strange):
        told = "; ".join(
            f"{row['channel']}, with {row['ratio']:.3g} times the value per count, read {row['at_zero']:.3g} "
            f"{row['unit']} at zero until now"
            for row in strange.to_dict("records")
        )
        yield f"Far from what was configured, and used: {told}."
    for row in refused.to_dict("records"):
        yield f"{row['channel']} stays as configured: {row['told']}."


def advise(lines: pd.DataFrame) -> Iterator[str]:
    """Yield how to use the rig with the lines, and how to calibrate again the channels without one."""
    good, refused = _split(lines)
    if len(good):
        yield "See what a study on this rig would do: python -m pipeline rig=FOLDER/documents/calibrated.yaml plan=true"
    if len(refused):
        begun = "rig=FOLDER/documents/calibrated.yaml " if len(good) else ""
        chosen = f"'calibration.only=[{','.join(refused['channel'])}]'"
        yield f"When that is mended, calibrate the rest: python -m pipeline ARGUMENTS {begun}{chosen}"


def _split(lines: pd.DataFrame) -> tuple[pd.DataFrame, pd.DataFrame]:
    good = lines["status"] == "calibrated"
    return lines[good], lines[~good]
