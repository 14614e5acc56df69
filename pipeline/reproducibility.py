"""Whether two runs of one configuration hold the same tables, and what differs between them that could be why.

Bytes decide; rows and columns are looked at only to say by how much tables differ.
"""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd
import pyarrow.parquet

from pipeline.checkout import describe_commit
from pipeline.errors import TableError
from pipeline.files import hash_file
from pipeline.ledger import Ledger
from pipeline.printing import join_some
from pipeline.table import read_frame

LARGEST_READ = 200_000_000
"""Bytes of a table up to which its values are compared."""
MOST_TOLD = 5
MACHINE = ("model", "processor", "system", "cores")


def compare_tables(now: Ledger, then: Ledger, stages: Sequence[str]) -> dict[str, str | None]:
    """Return how each table that stages wrote in two runs differs, or None where its bytes are the same."""
    found: dict[str, str | None] = {}
    for stage in stages:
        new, old = now.records[stage]["tables"], then.records.get(stage, {"tables": {}})["tables"]
        for table in {**old, **new}:
            if table not in new or table not in old:
                found[table] = "there is none now" if table in old else "there was none then"
            elif new[table]["sha256"] == old[table]["sha256"]:
                found[table] = None
            else:
                path = Path("tables") / f"{table}.parquet"
                found[table] = _describe_difference(then.folder / path, now.folder / path, old[table], new[table])
    return found


def describe_changes(now: Ledger, then: Ledger, stages: Sequence[str]) -> Iterator[str]:
    """Yield what differs between what two runs were made from, and on which machines."""
    pairs = [(then.records.get(each, {}), now.records[each]) for each in stages]
    if any(old.get("config") != new["config"] for old, new in pairs):
        yield "configuration: config.yaml is no longer what the stages had then"
    tables = {name for ledger in (now, then) for each in ledger.records.values() for name in each["tables"]}
    for word, key in (("code", "code"), ("libraries", "libraries"), ("input files", "inputs")):
        found = {}
        for old, new in pairs:
            before, after = old.get(key, {}), new[key]
            for name in sorted({**before, **after}):
                if before.get(name) != after.get(name) and name not in tables:
                    found[name] = f"{name} {before.get(name, 'absent')} -> {after.get(name, 'absent')}"
        if found:
            yield f"{word}: {join_some(list(found.values() if key == 'libraries' else found), MOST_TOLD)}"
    commits = [describe_commit(each.facts.get("git")) for each in (then, now)]
    if commits[0] != commits[1]:
        yield f"commit: {commits[0]} -> {commits[1]}"
    before, after = (each.facts.get("machine") or {} for each in (then, now))
    for key in MACHINE:
        if key in before and key in after and before[key] != after[key]:
            yield f"machine: {key} {before[key]} -> {after[key]}"


def _describe_difference(then: Path, now: Path, old: Mapping[str, Any], new: Mapping[str, Any]) -> str:
    rows = f"{old.get('rows')} rows then, {new.get('rows')} now" if old.get("rows") != new.get("rows") else ""
    if max(old["bytes"], new["bytes"]) > LARGEST_READ:
        return rows or "other bytes (too large to look further)"
    try:
        if hash_file(then) != old["sha256"]:
            return rows or "other bytes (the file of then is no longer whole)"
        before, after = read_frame(then), read_frame(now)
    except (OSError, TableError):
        return rows or "other bytes (the file of then is no longer there)"
    told = [rows] if rows else []
    for phrase, one, other in (("without", before, after), ("with new", after, before)):
        names = [str(each) for each in one if each not in other]
        if names:
            told.append(f"{phrase} {'column' if len(names) == 1 else 'columns'} {join_some(names, MOST_TOLD)}")
    if not rows:
        shared = [name for name in before if name in after]
        differing = [_describe_values(str(name), before[name], after[name]) for name in shared]
        told += [*filter(None, differing)][:MOST_TOLD]
    if told:
        return "; ".join(told)
    writers = [pyarrow.parquet.read_metadata(each).created_by for each in (then, now)]
    if writers[0] != writers[1]:
        return f"the same values, written by {writers[0]} then and by {writers[1]} now"
    return "the same values, in other bytes (units, descriptions or order of columns)"


def _describe_values(name: str, before: pd.Series, after: pd.Series) -> str | None:
    if before.dtype != after.dtype:
        return f"{name}: {before.dtype} -> {after.dtype}"
    unequal = ~((before == after) | (before.isna() & after.isna()))
    count = int(unequal.sum())
    if not count:
        return None
    floats = pd.api.types.is_float_dtype(before)
    most = f", by at most {(before - after)[unequal].abs().max():.3g}" if floats else ""
    return f"{name} differs in {count} of {len(before)} rows{most}"
