"""Comparison of methods over paired experiments: `paired`."""

from stages.statistics.paired import PairedComparison, adjust_holm, compare_pairs

__all__ = ["PairedComparison", "adjust_holm", "compare_pairs"]
