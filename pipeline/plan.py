"""Order, freshness, and the reason for each.

A study, its stages and the ledgers of earlier runs flow in; out flows one `Step` per stage: fresh, with the run that
holds its tables, or to run, with the reason. Freshness is content: the stage's config slice, the bytes of its inputs
and of its code, and the versions of its libraries.
"""

from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from functools import reduce
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from pipeline.config import Study
from pipeline.errors import ConfigError
from pipeline.files import hash_json
from pipeline.inputs import hash_inputs
from pipeline.ledger import Ledger
from pipeline.printing import join_some, shorten
from pipeline.sources import hash_sources, library_versions, list_imported_by_name
from pipeline.stage import Stage

LONGEST_VALUE = 60
"""Characters of a value in a reason."""
MOST_NAMED = 2
"""Changes of one kind, or tables, that a reason names."""
MOST_ALIKE = 5
"""Keys in which an earlier result of a stage may differ for its difference to be a change."""
MOST_COMPARED = 100
"""Earlier results of a stage, the newest, of which the most similar one tells what changed."""


@dataclass(frozen=True)
class Step:
    """What is to be done about one stage, with the reason for a person, and the run that holds fresh tables.

    The action is ``fresh``, ``kept`` (fresh but for its code: measured on real hardware), ``run``, or ``wait`` (an
    input will be remade; whether the stage must run depends on how that comes out).
    """

    stage: Stage
    action: str
    reason: str
    source: Ledger | None = None


@dataclass(frozen=True)
class Ingredients:
    """All that a stage's result depends on.

    These are the stage's slice of the configuration, the content hashes of the tables that it reads and of the files
    that its configuration names, and code and libraries as of `pipeline.sources`. If it is `measured` on real hardware,
    a change of code or libraries makes nothing stale. Tables whose content is not known yet are `waiting`. The `extent`
    is the stage's.
    """

    config: dict[str, Any]
    inputs: dict[str, str]
    code: dict[str, str]
    libraries: dict[str, str]
    measured: bool
    waiting: tuple[str, ...] = ()
    extent: tuple[str, ...] = ()

    @property
    def fingerprint(self) -> str:
        """Hash of what counts."""
        return self._hash(self.config)

    @property
    def parts_fingerprint(self) -> str:
        """Hash of what counts in a part of the stage's loop."""
        config = deepcopy(self.config)
        for key in self.extent:
            *sections, name = key.split(".")
            reduce(lambda section, each: section.get(each) or {}, sections, config).pop(name, None)
        return self._hash(config)

    def _hash(self, config: Mapping[str, Any]) -> str:
        counted: dict[str, Any] = {"config": config, "inputs": self.inputs}
        if not self.measured:
            counted.update(code=self.code, libraries=self.libraries)
        return hash_json(counted)

    def differences(self, record: Mapping[str, Any]) -> dict[str, list[str]]:
        """Say which keys, inputs, source files and versions differ from an earlier record's, most telling kind first.

        The kinds are ``config``, ``input``, ``code`` and ``library``.
        """
        inputs, old, code = [], record["inputs"], record["code"]
        for name in [*self.inputs, *(each for each in old if each not in self.inputs and each not in self.waiting)]:
            if old.get(name) != self.inputs.get(name):
                word = "changed" if name in self.inputs else "is no longer there"
                inputs.append(f"input {name} {word if name in old else 'is new'}")
        config = _config_differences(record["config"], self.config)
        counted = {*code, *self.code} if not config else {*code} & {*self.code}  # another configuration has other files
        return {
            "config": config,
            "input": inputs,
            "code": [name for name in sorted(counted) if code.get(name) != self.code.get(name)],
            "library": _config_differences(record["libraries"], self.libraries),
        }

    def changes(self, record: Mapping[str, Any]) -> list[str]:
        """Say in phrases how these ingredients differ from those of an earlier record, most telling first."""
        told = []
        for kind, found in self.differences(record).items():
            if kind == "input":
                told += found
            elif found:
                told.append(f"{kind} changed ({join_some(found, MOST_NAMED)})")
        return told


def gather(study: Study, stage: Stage, inputs: dict[str, str]) -> Ingredients:
    """Return the ingredients of a stage, given content hashes of tables, of which those that it reads count.

    The files that its configuration names are hashed anew.
    """
    read = {name: digest for name, digest in inputs.items() if name in stage.reads}
    package = study.settings.workflow.package
    values, config, section = study.slice(stage), study.config(stage), study.target(stage)
    built = study.build(section) if section else None
    brought = hash_inputs(built) if isinstance(built, BaseModel) else {}
    modules = [stage.module, *list_imported_by_name([values, config, built])]
    return Ingredients(
        values,
        {**read, **hash_inputs(config), **{f"{section}.{name}": digest for name, digest in brought.items()}},
        hash_sources(package, modules),
        library_versions(package, modules),
        bool(getattr(built, "real", False)),
        extent=stage.extent,
    )


def decide(stage: Stage, ingredients: Ingredients, ledgers: Sequence[Ledger]) -> Step:
    """Say whether a stage is fresh, and in which of the ledgers, the most welcome first, or why it must run."""
    fingerprint = ingredients.fingerprint
    damage = None
    for ledger in ledgers:
        record = ledger.finished(stage.name)
        if record is None or record["fingerprint"] != fingerprint:
            continue
        if not all(table.name in record["tables"] for table in stage.writes):
            continue
        damaged = ledger.damage(record)
        if damaged is None:
            changed = [each for each in ingredients.changes(record) if each.startswith(("code", "library"))]
            if changed:  # of what was measured
                return Step(stage, "kept", f"measured in {record['origin']}; since then {changed[0]}", ledger)
            return Step(stage, "fresh", f"made in {record['origin']}", ledger)
        damage = damage or damaged
    reason = damage or _describe_changes(stage, ingredients, ledgers) or "not made before"
    left = find_parts(stage, ingredients, ledgers) if stage.extent and ingredients.measured else None
    return Step(stage, "run", f"{reason}; goes on with what {left[0].name} measured" if left else reason)


def find_parts(
    stage: Stage, ingredients: Ingredients, ledgers: Sequence[Ledger], anew: bool = False
) -> tuple[Ledger, Path] | None:
    """Return the run that left most parts of the same loop, and their folder, the most welcome among equals, or None.

    The loop may have been shorter or longer. Where one of the same length was finished, and is to be made `anew`, no
    finished one counts.
    """
    done = [each.finished(stage.name) for each in ledgers] if anew else []
    anew = any(record and record["fingerprint"] == ingredients.fingerprint for record in done)
    found: dict[int, tuple[Ledger, Path]] = {}
    for ledger in ledgers:
        record = ledger.records.get(stage.name)
        if record is None or (anew and record["status"] == "done") or not (ledger.folder / "parts").is_dir():
            continue
        then = {name: record.get(name, {}) for name in ("config", "inputs", "code", "libraries")}
        earlier = replace(ingredients, **then, measured=bool(record.get("measured")))
        if earlier.parts_fingerprint != ingredients.parts_fingerprint:
            continue
        folder = parts_folder(ledger, stage, record.get("parts", record["fingerprint"]))
        if folder.is_dir():
            found.setdefault(len(list(folder.iterdir())), (ledger, folder))
    return found[max(found)] if found else None


def parts_folder(ledger: Ledger, stage: Stage, fingerprint: str) -> Path:
    """Return where a run keeps the parts of a stage's loop."""
    return ledger.folder / "parts" / f"{stage.name}-{fingerprint[:16]}"


def _describe_changes(stage: Stage, ingredients: Ingredients, ledgers: Sequence[Ledger]) -> str:
    """Say in two phrases how a stage differs from the most similar of its newest records, the newest among equals."""
    records = [record for each in ledgers if (record := each.finished(stage.name))][:MOST_COMPARED]
    if not records:
        return "not made before"
    nearest = min(records, key=lambda record: sum(map(len, ingredients.differences(record).values())))
    config = ingredients.differences(nearest)["config"]
    if len(config) > MOST_ALIKE:
        return f"not made before: the most similar result differs in {join_some(config, 1)}"
    return "; ".join(ingredients.changes(nearest)[:2])


def choose_stages(study: Study, stages: Sequence[Stage]) -> list[Stage]:
    """Return all stages of a workflow, or those asked for by name with what they need, in the order of the data."""
    asked = study.settings.stages
    if asked is None:
        return list(stages)
    chosen: list[Stage] = []
    for stage in reversed(stages):
        written = {table.name for table in stage.writes}
        if stage.name in asked or any(written & {*each.reads} for each in chosen):
            chosen.insert(0, stage)
    return chosen


def make_plan(study: Study, stages: Sequence[Stage], ledgers: Sequence[Ledger]) -> list[Step]:
    """Plan all stages of a workflow, or those asked for by name with what they need; ledgers come newest first.

    A ConfigError says that stages are asked for by name and a table they read is not fresh.
    """
    asked = study.settings.stages
    steps: list[Step] = []
    stale: list[Step] = []
    hashes: dict[str, str | None] = {}
    for each in choose_stages(study, stages):
        step = _plan_one(study, each, ledgers, hashes)
        if asked is not None and each.name in asked:
            step = Step(each, "run", "asked for by name")
        elif asked is not None and step.source is None:
            stale.append(step)
        steps.append(step)
        for table in each.writes:
            hashes[table.name] = step.source.records[each.name]["tables"][table.name]["sha256"] if step.source else None
    if asked is not None and stale:
        needed = [each.name for each in stages if each.name in {*asked, *(step.stage.name for step in stale)}]
        raise ConfigError(
            f"stages=[{','.join(asked)}]: what is needed first is not fresh "
            f"({'; '.join(f'{step.stage.name}: {step.reason}' for step in stale)}); "
            f"type stages=[{','.join(needed)}], or leave stages= out"
        )
    return steps


def _plan_one(study: Study, stage: Stage, ledgers: Sequence[Ledger], hashes: Mapping[str, str | None]) -> Step:
    inputs = {name: digest for name in stage.reads if (digest := hashes[name])}
    waiting = tuple(name for name in stage.reads if hashes[name] is None)
    ingredients = replace(gather(study, stage, inputs), waiting=waiting)
    if not waiting:
        return decide(stage, ingredients, ledgers)
    if own := _describe_changes(stage, ingredients, ledgers):
        return Step(stage, "run", own)
    named = " and ".join(waiting) if len(waiting) <= MOST_NAMED else join_some(waiting, MOST_NAMED)
    return Step(stage, "wait", f"fresh if {named} come out unchanged")


def _config_differences(old: Any, new: Any, path: str = "") -> list[str]:
    if isinstance(old, dict) and isinstance(new, dict):
        return [
            difference
            for key in {**new, **old}
            for difference in _config_differences(old.get(key), new.get(key), f"{path}.{key}" if path else str(key))
        ]
    texts = [shorten("absent" if each is None else str(each), LONGEST_VALUE) for each in (old, new)]
    return [] if old == new else [f"{path} {' -> '.join(texts)}"]
