"""Records of runs that an earlier version made, under today's names.

A ledger's facts of an older format flow in; facts flow out as today's version would have written them, so that what was
measured on real hardware is found, kept and resumed. The old names stand in ``conf/renames.yaml``.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any

import yaml

from pipeline.files import hash_json
from pipeline.places import CONFIG_FOLDER


def update_facts(facts: Mapping[str, Any], form: int) -> dict[str, Any]:
    """Return a ledger's facts with today's names.

    Parameters
    ----------
    facts : mapping
        Of an older format.
    form : int
        Today's format.

    Returns
    -------
    dict
        A measured stage's record has the fingerprint of its configuration under today's names, and says under which
        one the parts of its loop lie (``parts``).
    """
    stages = {name: _update_record(record) for name, record in facts["stages"].items()}
    return {**facts, "format": form, "stages": stages}


def _update_record(record: Mapping[str, Any]) -> dict[str, Any]:
    config = rename(record["config"])
    if not record.get("measured") or config == record["config"]:
        return {**record, "config": config}
    fingerprint = hash_json({"config": config, "inputs": record["inputs"]})
    return {**record, "config": config, "fingerprint": fingerprint, "parts": record["fingerprint"]}


def rename(values: Any) -> Any:
    """Return plain values whose ``_target_`` keys have today's names."""
    if isinstance(values, list):
        return [rename(each) for each in values]
    if not isinstance(values, Mapping):
        return values
    return {
        name: _rename_target(each) if name == "_target_" and isinstance(each, str) else rename(each)
        for name, each in values.items()
    }


def _rename_target(target: str) -> str:
    for before, now in _read_targets():
        if f"{target}.".startswith(f"{before}."):
            return now + target.removeprefix(before)
    return target


@cache
def _read_targets() -> tuple[tuple[str, str], ...]:
    """Return old and new names, the longest old ones first."""
    targets = yaml.safe_load((CONFIG_FOLDER / "renames.yaml").read_text(encoding="utf-8"))["targets"]
    return tuple(sorted(targets.items(), key=lambda each: -len(each[0])))
