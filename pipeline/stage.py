"""A stage: a function plus the tables it reads and writes; its signature is the wiring.

A decorated function flows in. Out flows a `Stage` that knows the config sections it reads (the fields of the model that
annotates ``cfg``), the tables it reads (its other parameters; one whose default is None is read where the workflow has
it, and None otherwise) and the tables it writes (the decorator's arguments). A parameter annotated with a dataclass
stands for several tables, one per field.
"""

import importlib
import inspect
import pkgutil
import typing
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import wraps
from typing import Any

from pydantic import BaseModel

from pipeline.errors import ConfigError, WiringError, suggest
from pipeline.renames import find_today
from pipeline.table import Table


@dataclass(frozen=True)
class Stage:
    """One step of a workflow, by the name of its function and of its config group.

    The function is called with ``cfg``, the tables it reads, and ``ctx``, by name; it returns the tables it writes, in
    their order. The fields of its config are the top-level sections that reach it. A workflow may lack the `optional`
    ones of the tables it reads. A `preview` takes the config and returns lines that the plan shows, of what the stage
    would make of files that it reads. From the `stream`, with the seed, its random numbers come, whatever the stage is
    called; None where it draws none. The `extent` are keys (dotted) that say how many parts its loop has, and nothing
    about what one of them holds.
    """

    name: str
    function: Callable[..., Any]
    config: type[BaseModel]
    reads: tuple[str, ...]
    writes: tuple[Table, ...]
    optional: tuple[str, ...] = ()
    preview: Callable[[Any], Iterable[str]] | None = None
    stream: str | None = None
    extent: tuple[str, ...] = ()

    @property
    def module(self) -> str:
        """Dotted name of the module that defines the stage."""
        return self.function.__module__

    @property
    def summary(self) -> str:
        """First line of the function's docstring."""
        return (inspect.getdoc(self.function) or self.name).splitlines()[0]


def stage(
    *writes: Table,
    stream: str | None = None,
    preview: Callable[[Any], Iterable[str]] | None = None,
    extent: tuple[str, ...] = (),
) -> Callable[[Callable[..., Any]], Stage]:
    """Make a function a stage that writes the given tables; stream, preview and extent are those of `Stage`."""

    def decorate(function: Callable[..., Any]) -> Stage:
        name = function.__name__
        signature = inspect.signature(function).parameters
        parameters = list(signature)
        hints = typing.get_type_hints(function)
        config = hints.get("cfg")
        if not (isinstance(config, type) and issubclass(config, BaseModel)) or "ctx" not in parameters:
            raise WiringError(
                f"stage {name}: expected parameters cfg (annotated with a pydantic model) and ctx, got {parameters}"
            )
        read = [each for each in parameters if each not in ("cfg", "ctx")]
        bundles: dict[str, type] = {each: hints[each] for each in read if is_dataclass(hints.get(each))}
        tables = [one for each in read for one in (fields(bundles[each]) if each in bundles else [signature[each]])]
        reads = tuple(table.name for table in tables)
        twice = [table for table in reads if reads.count(table) > 1]
        if twice:
            raise WiringError(f"stage {name}: expected each table in one parameter, got {twice[0]} in two")
        optional = tuple(table.name for table in tables if table.default is None)
        called = _bundle_tables(function, bundles) if bundles else function
        return Stage(name, called, config, reads, writes, optional, preview, stream, extent)

    return decorate


def list_tables(stages: Iterable[Stage]) -> dict[str, Table]:
    """Return the contracts of all tables that stages write, by name."""
    return {table.name: table for each in stages for table in each.writes}


def _bundle_tables(function: Callable[..., Any], bundles: Mapping[str, type]) -> Callable[..., Any]:
    """Return a function that takes each table by name and passes those of a dataclass on as one value."""

    @wraps(function)
    def call(**given: Any) -> Any:
        made = {
            name: kind(**{field.name: given.pop(field.name) for field in fields(kind) if field.name in given})
            for name, kind in bundles.items()
        }
        return function(**given, **made)

    return call


def load_stages(package: str, names: Sequence[str] | None = None) -> list[Stage]:
    """Import the named stages of a package, or all: its files, and those of its folders, are stages.

    Each is a function in the file of its name, or in the one that its name ends with (``unseen_bank`` in ``bank.py``).
    """
    known = _find_modules(package)
    if names is None:
        modules = [importlib.import_module(each) for each in known.values()]
        return [found for module in modules for found in vars(module).values() if isinstance(found, Stage)]
    stages = []
    for name in names:
        file = name if name in known else name.rpartition("_")[2]
        found = getattr(importlib.import_module(known[file]), name, None) if file in known else None
        if isinstance(found, Stage):
            stages.append(found)
        elif name in known:
            raise WiringError(f"{known[name].replace('.', '/')}.py: expected a stage function named {name}")
        else:
            offered = suggest(name, known, find_today("names", name))
            raise ConfigError(f"workflow.stages: no stage {name!r} in {package}; {offered}")
    return stages


def _find_modules(package: str) -> dict[str, str]:
    """Return the dotted name of each file in a package and in its folders, by the file's own name."""
    folders = [package]
    modules: dict[str, str] = {}
    for folder in folders:
        for each in pkgutil.iter_modules(importlib.import_module(folder).__path__):
            if not each.ispkg:
                path = f"{folder}.{each.name}"
                if modules.setdefault(each.name, path) != path:
                    files = " and ".join(f"{name.replace('.', '/')}.py" for name in (modules[each.name], path))
                    raise WiringError(f"{files}: expected one file of a name, as a stage is found by it; rename one")
            elif folder == package:
                folders.append(f"{folder}.{each.name}")
    return modules


def order_stages(stages: Sequence[Stage]) -> list[Stage]:
    """Return the stages so that each comes after those whose tables it reads.

    A table that a stage can do without, and which no stage writes, is no longer among those that it reads.
    """
    writer: dict[str, Stage] = {}
    for each in stages:
        for table in each.writes:
            if table.name in writer:
                raise WiringError(f"table {table.name} is written by {writer[table.name].name} and by {each.name}")
            writer[table.name] = each
    stages = [
        replace(each, reads=tuple(name for name in each.reads if name in writer or name not in each.optional))
        for each in stages
    ]
    for each in stages:
        for name in each.reads:
            if name not in writer:
                raise WiringError(
                    f"stage {each.name} reads table {name}, which no stage of this workflow writes; "
                    "add the one that does to workflow.stages"
                )
    ordered: list[Stage] = []
    waiting = list(stages)
    while waiting:
        awaited = list_tables(waiting)
        ready = next((each for each in waiting if not awaited.keys() & {*each.reads}), None)
        if ready is None:
            raise WiringError(f"stages wait for each other: {', '.join(each.name for each in waiting)}")
        ordered.append(ready)
        waiting.remove(ready)
    return ordered
