"""Verdicts on a family of tests, whose p-values are adjusted together.

Rows with a difference and p-values flow in; the same rows with ``p_holm`` and ``verdict`` flow out.
"""

import numpy as np
import pandas as pd

from stages.science.statistics.paired import adjust_holm

LEVEL = 0.05


def judge_differences(family: pd.DataFrame, p: str, negative: str, positive: str) -> pd.DataFrame:
    """Return the rows with what a significant difference of either sign is called, else ``undecided``."""
    adjusted = adjust_holm(family[p].to_numpy(dtype=float))
    found = np.where(family["difference"] < 0, negative, positive)
    return family.assign(p_holm=adjusted, verdict=np.where(adjusted < LEVEL, found, "undecided"))


def list_verdicts(negative: str, positive: str, ending: str = "") -> list[str]:
    """Return every verdict of `judge_with_equivalence` with these words."""
    within = [f"{each} within the margin" for each in (negative, positive)]
    return [negative + ending, positive + ending, "equivalent", *within, "undecided"]


def judge_with_equivalence(
    family: pd.DataFrame, p: str, negative: str, positive: str, ending: str = "", equivalent: str = "equivalent"
) -> pd.DataFrame:
    """Return the rows, with columns difference, p_tost and `p`, with a verdict on difference and equivalence.

    A significant difference of either sign is called `negative` or `positive`; ``within the margin`` follows where the
    test of equivalence is significant too, else `ending`. Without such a difference, equivalence has a word as well.
    """
    family = family.assign(p_holm=adjust_holm(family[p].to_numpy(dtype=float)))
    different, same = family["p_holm"] < LEVEL, family["p_tost"] < LEVEL
    found = np.where(family["difference"] < 0, negative, positive)
    told = [np.char.add(found, " within the margin"), np.char.add(found, ending), np.array(equivalent)]
    return family.assign(verdict=np.select([different & same, different, same], told, "undecided"))
