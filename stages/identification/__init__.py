"""Identify muscle models by designed interaction: a bank, candidates, chosen trials, how the error falls."""
