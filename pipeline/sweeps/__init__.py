"""Sweeps: many jobs by one command, each in a folder of its own, and one table of all."""
