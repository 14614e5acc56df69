"""Runs stages, keeps their tables, remembers what happened.

Config and stages flow in (Hydra composes, `config` validates, `stage` reads signatures); Parquet tables, figures,
a ledger and a report flow out into one folder per run. Nothing in this package knows what the stages study.

The reading order is the order of a run: `config`, `stage`, `plan`, `runs`, `runner` with `context`, `ledger`, `report`;
a sweep of many is `sweep`, `launch`, `job`; what was left is looked at in `review`.
"""
