"""Comparison of methods and groups, tests of equivalence, power and coverage.

Paired experiments: `paired`, `signed_rank`. Independent groups: `groups`. Equivalence for a margin: `equivalence`.
Designs: `power`. Shares of values within intervals: `coverage`. Choices of experiments: `concentration`.
"""

from stages.statistics.concentration import Choices, Concentration, judge_concentration
from stages.statistics.coverage import BlockCoverage, Coverage, cover, cover_blocks
from stages.statistics.equivalence import Equivalence, judge_equivalence, judge_paired_equivalence
from stages.statistics.groups import GroupComparison, compare_groups
from stages.statistics.paired import PairedComparison, adjust_benjamini_yekutieli, adjust_holm, compare_pairs
from stages.statistics.power import (
    find_smallest_n,
    power_of_equivalence,
    power_of_paired_equivalence,
    power_of_paired_test,
    power_of_welch_test,
)
from stages.statistics.signed_rank import RankComparison, compare_ranks

__all__ = [
    "BlockCoverage",
    "Choices",
    "Concentration",
    "Coverage",
    "Equivalence",
    "GroupComparison",
    "PairedComparison",
    "RankComparison",
    "adjust_benjamini_yekutieli",
    "adjust_holm",
    "compare_groups",
    "compare_pairs",
    "compare_ranks",
    "cover",
    "cover_blocks",
    "find_smallest_n",
    "judge_concentration",
    "judge_equivalence",
    "judge_paired_equivalence",
    "power_of_equivalence",
    "power_of_paired_equivalence",
    "power_of_paired_test",
    "power_of_welch_test",
]
