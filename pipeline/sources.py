"""Which code a stage's result depends on, and which library versions.

Names of modules flow in; out flow hashes of the files of these modules and of all that they import, transitively, and
the versions of the libraries that any of them imports. The runner's own package does not count.
"""

import ast
import importlib.metadata
import importlib.util
import platform
import re
import sys
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from functools import cache
from itertools import takewhile
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from pipeline.files import hash_file
from pipeline.flat import walk

DEFINITION = re.compile(rb"^(?:class|def|async|@)", re.MULTILINE)


def hash_sources(package: str, modules: Iterable[str]) -> dict[str, str]:
    """Return the hash of every source file that modules depend on, by its path from the folder that holds the package.

    Of a module outside the stages' package, what it imports from its own package counts, too.
    """
    root = Path(importlib.import_module(package).__path__[0]).parents[package.count(".")]
    hashes = {}
    for path in _closure(package, tuple(sorted(set(modules)))):
        top = root if path.is_relative_to(root) else path.parents[len(_list_packages(path))]
        hashes[path.relative_to(top).as_posix()] = hash_file(path)
    return hashes


def library_versions(package: str, modules: Iterable[str]) -> dict[str, str]:
    """Return the version of Python and of every library that modules import, directly or through others."""
    files = _closure(package, tuple(sorted(set(modules))))
    names = {name.split(".")[0] for path in files for name in _imports(path)}
    outside = names - set(sys.stdlib_module_names) - {package.split(".")[0], "pipeline"}
    found = {name: version for name in sorted(outside) if (version := _version(name))}
    return {"python": platform.python_version(), **found}


def list_imported_by_name(value: Any) -> Iterator[str]:
    """Yield the modules that a configuration (a validated model, or plain values) imports by name.

    Of models, these are the modules that define them and those that they name under ``imported_by_name``; of plain
    mappings, those that ``_target_`` names.
    """
    for _, each in walk(value):
        if isinstance(each, BaseModel):
            yield type(each).__module__
            yield from getattr(each, "imported_by_name", ())
        elif isinstance(each, Mapping) and isinstance(each.get("_target_"), str):
            yield each["_target_"].rpartition(".")[0]


@cache
def _closure(package: str, modules: tuple[str, ...]) -> tuple[Path, ...]:
    found: set[Path] = set()
    counted = [each for each in modules if each.split(".")[0] not in ("pipeline", "pydantic")]
    followed = (f"{package}.", *(f"{each.rpartition('.')[0]}." for each in counted if "." in each))
    waiting = [path for module in counted for path in _find_files(module)]
    while waiting:
        path = waiting.pop()
        if path in found:
            continue
        found.add(path)
        names = (name for name in _imports(path) if name.startswith(followed))
        waiting.extend(file for name in names for file in _find_files(name))
    return tuple(sorted(found))


@cache
def _find_files(module: str) -> tuple[Path, ...]:
    """Return the file of a module and those of the packages around it, as far as these do anything."""
    parts = module.split(".")
    files = [_find_file(".".join(parts[: k + 1])) for k in range(len(parts))]
    return tuple(each for each in files if each and (each.name != "__init__.py" or _does_something(each)))


@cache
def _find_file(module: str) -> Path | None:
    """Return the file of a module, without importing what is around it; None for a name within a module."""
    top, *within = module.split(".")
    try:
        spec = importlib.util.find_spec(top)
    except ValueError:  # __main__
        return None
    for each in spec.submodule_search_locations or [] if spec else []:
        path = Path(each, *within)
        for file in (path.with_suffix(".py"), path / "__init__.py") if within else (path / "__init__.py",):
            if file.is_file():
                return file
    return Path(spec.origin) if spec and spec.origin and spec.origin.endswith(".py") and not within else None


@cache
def _does_something(path: Path) -> bool:
    body = ast.parse(path.read_bytes()).body
    return any(not (isinstance(each, ast.Expr) and isinstance(each.value, ast.Constant)) for each in body)


@cache
def _list_packages(path: Path) -> tuple[str, ...]:
    """Return the names of the packages that a file lies in, the outermost first."""
    inside = list(takewhile(lambda folder: (folder / "__init__.py").is_file(), path.parents))
    return tuple(each.name for each in reversed(inside))


@cache
def _imports(path: Path) -> tuple[str, ...]:
    return tuple(_walk_imports(_parse(path.read_bytes()), _list_packages(path)))


def _parse(source: bytes) -> ast.Module:
    """Return the syntax tree of a module, but for the definitions after the last mention of an import: most of it."""
    rest = DEFINITION.search(source, source.rfind(b"import"))
    with suppress(SyntaxError):  # of a text that was taken for a definition
        return ast.parse(source[: rest.start()] if rest else source)
    return ast.parse(source)


def _walk_imports(node: ast.AST, packages: tuple[str, ...]) -> Iterator[str]:
    if isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING":
        return
    if isinstance(node, ast.Import):
        yield from (each.name for each in node.names)
    elif isinstance(node, ast.ImportFrom):
        around = packages[: len(packages) - node.level + 1] if node.level else ()
        module = ".".join([*around, *([node.module] if node.module else [])])
        yield module
        yield from (f"{module}.{each.name}" for each in node.names)
    for field in ("body", "orelse", "handlers", "finalbody", "cases"):  # an import is a statement, and within these
        held = getattr(node, field, ())
        for each in held if isinstance(held, list) else ():
            yield from _walk_imports(each, packages)


@cache
def _version(name: str) -> str | None:
    try:
        return importlib.metadata.version({"sklearn": "scikit-learn"}.get(name, name))
    except importlib.metadata.PackageNotFoundError:
        return None
