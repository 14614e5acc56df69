"""Rigs: what executes a trial and returns a recording, simulated or real, under one contract.

The rigs themselves are named by configuration and imported from there.
"""
