"""What a run's folder keeps of it beside the ledger, to look at: a folder flows in, mappings, frames flow out."""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

import pandas as pd

from pipeline.errors import TableError
from pipeline.ledger import Ledger
from pipeline.printing import SHOWN, show_percent
from pipeline.renames import rename

Kind = TypeVar("Kind")


def read_config(folder: Path) -> dict[str, Any]:
    """Return a run's whole configuration; empty where it is not there or cannot be read."""
    found = read_yaml(folder / "config.yaml")
    return rename(found) if isinstance(found, dict) else {}


def read_yaml(path: Path) -> Any:
    """Return what a file holds; the words of one that is no YAML, None for one that is not there."""
    import yaml

    try:
        content = path.read_text(encoding="utf-8", errors="replace")
        return yaml.load(content, Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader))
    except OSError:
        return None
    except (yaml.YAMLError, RecursionError, ValueError):
        return re.split(r"[\s'\"]+", content)


def read_slices(ledger: Ledger) -> dict[str, Any]:
    """Return the sections of the configuration that a run's stages read, as its ledger has them."""
    return {name: section for record in ledger.records.values() for name, section in record["config"].items()}


def read_workflow(config: Mapping[str, Any], key: str, kind: type[Kind]) -> Kind:
    """Return what a run's workflow says under a key, of a kind; empty where it says nothing of this kind."""
    workflow = config.get("workflow")
    found = workflow.get(key) if isinstance(workflow, dict) else None
    return found if isinstance(found, kind) else kind()


def list_headlines(config: Mapping[str, Any]) -> list[str]:
    """Return the names of the tables that a run's workflow wants seen first."""
    return [str(each) for each in read_workflow(config, "headline", list)]


def list_tables(ledger: Ledger) -> dict[str, dict[str, Any]]:
    """Return hash, rows and bytes of each table of a run, by its name."""
    return {
        name: facts
        for record in ledger.records.values()
        if record["status"] == "done"
        for name, facts in record["tables"].items()
    }


def read_whole_table(ledger: Ledger, name: str) -> tuple[pd.DataFrame, dict[str, str], str] | None:
    """Return a table of a run as it is to be read, the units of its columns, its title; None if it cannot be read."""
    import pyarrow.parquet

    from pipeline.table import read_frame

    path = ledger.folder / "tables" / f"{name}.parquet"
    try:
        frame = read_frame(path)
        schema = pyarrow.parquet.read_schema(path)
    except (TableError, OSError, ValueError):
        return None
    told = {field.name: field.metadata for field in schema if field.metadata}
    units = {
        name: (each.get(SHOWN.encode()) or each.get(b"unit", b"1")).decode(errors="replace")
        for name, each in told.items()
    }
    title = (schema.metadata or {}).get(b"title", name.encode()).decode(errors="replace")
    return show_percent(frame, units), units, title


def read_surroundings(ledger: Ledger) -> dict[str, dict[str, str]]:
    """Return with which code and libraries, and on which machine, a run was made."""
    git, machine = ledger.facts.get("git") or {}, ledger.facts.get("machine") or {}
    records = ledger.records.values()
    return {
        "code": {
            "commit": str(git.get("commit", "unknown"))[:10],
            "changes": "unknown" if not git else "none" if git.get("clean") else "some that were not committed",
        },
        "machine": {key: str(value) for key, value in machine.items() if key != "executable"},
        "library": {name: str(version) for record in records for name, version in record["libraries"].items()},
        "source": {name: str(digest)[:8] for record in records for name, digest in record["code"].items()},
    }
