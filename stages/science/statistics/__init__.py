"""Comparison of methods and groups, tests of equivalence, power and coverage.

Paired experiments: `paired`, `signed_rank`. Independent groups: `groups`. Equivalence for a margin: `equivalence`.
Designs: `power`. Shares, medians, values within intervals: `intervals`. Choices of experiments: `concentration`.
"""
