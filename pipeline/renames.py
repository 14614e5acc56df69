"""Names that an earlier version used: found in the records of its runs, and refused where they are typed.

A ledger's facts of an older format flow in; facts flow out as today's version would have written them, so that what was
measured on real hardware is found, kept and resumed. A name that was typed flows in; today's name flows out, for the
message that refuses it. The old names stand in ``conf/renames.yaml``.
"""

from collections.abc import Mapping
from functools import cache
from typing import Any, Literal

import yaml

from pipeline.files import CONFIG_FOLDER, hash_json


def update_facts(facts: Mapping[str, Any], form: int) -> dict[str, Any]:
    """Return a ledger's facts of an older format with today's names and format.

    A measured stage's record gets the fingerprint of its configuration under today's names, with the keys that are new
    at the values that do what was done before, and says under which one the parts of its loop lie (``parts``).
    """
    stages = {
        name: {**record, "config": complete(name, rename(record["config"]))} for name, record in facts["stages"].items()
    }
    for name, before in facts["stages"].items():
        if before.get("measured") and stages[name]["config"] != before["config"]:
            fingerprint = hash_json({"config": stages[name]["config"], "inputs": before["inputs"]})
            stages[name].update(fingerprint=fingerprint, parts=before.get("parts", before["fingerprint"]))
    return {**facts, "format": form, "stages": stages}


def rename(values: Any, path: str = "") -> Any:
    """Return the plain values at a path (dotted) of a configuration, keys and classes under today's names."""
    if isinstance(values, list):
        return [rename(each, path) for each in values]
    if isinstance(values, str) and path.rpartition(".")[2] == "_target_":
        return find_today("targets", values) or values
    if not isinstance(values, Mapping):
        return values
    renamed = {}
    for name, each in values.items():
        key = f"{path}.{name}" if path else str(name)
        today = find_today("keys", key)
        renamed[today.rpartition(".")[2] if today else name] = rename(each, key)
    return renamed


def complete(stage: str, config: dict[str, Any]) -> dict[str, Any]:
    """Return a stage's configuration with the keys that are new since, at the values that do what was done before."""
    added: dict[str, Any] = _read_names()["added"].get(stage, {})
    for section, values in added.items():
        config = {**config, section: {**values, **config.get(section, {})}}
    return config


def find_today(kind: Literal["targets", "keys", "options", "names"], name: str) -> str | None:
    """Return today's name of what was renamed, or None; the longest beginning that was renamed decides.

    The kinds are ``targets`` (modules and classes), ``keys`` (of the configuration), ``options`` (of config groups, as
    ``group=option``) and ``names`` (of stages, tables and columns).
    """
    names = _read_names()[kind]
    before = max((each for each in names if f"{name}.".startswith(f"{each}.")), key=len, default=None)
    return None if before is None else str(names[before]) + name.removeprefix(before)


@cache
def _read_names() -> dict[str, dict[str, Any]]:
    """Return today's name by the old one, for each kind of name, and under ``added`` what is new in each stage."""
    return dict(yaml.safe_load((CONFIG_FOLDER / "renames.yaml").read_text(encoding="utf-8")))
