"""Copies of runs where colleagues look: a folder of a run or sweep flows in, what a tracker shows of it flows out.

The folders stay the record. `entries` says what is told of each, whichever tracker it is told to; `mlflow_store` tells
it to MLflow; `follower` has a process of its own do that while a command runs; `destination` knows what waits.
"""
