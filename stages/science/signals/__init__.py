"""Signals that people and pressures follow, and what is measured from them: trajectories, noise, filters, errors.

Generators and plain numbers flow in, arrays over time come out; time is always the first axis.
"""
