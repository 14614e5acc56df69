"""Comparison of methods and groups, tests of equivalence, power and coverage.

Paired experiments: `paired`, `signed_rank`. Independent groups: `groups`. Equivalence for a margin: `equivalence`.
Designs: `power`. Shares of values within intervals: `coverage`. Choices of experiments: `concentration`.
"""
