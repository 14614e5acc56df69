"""Which code a stage's result depends on, and which library versions.

A module's name flows in; out flow the bytes (as hashes) of its file, of every science folder that it imports, directly
or through another, and the versions of the libraries that any of them import. A folder counts as a whole, so a file
that is loaded by name inside it counts too.
"""

from __future__ import annotations

import ast
import importlib.metadata
import importlib.util
import platform
import sys
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path

from pipeline.files import hash_file


def hash_sources(package: str, modules: Sequence[str]) -> dict[str, str]:
    """Return the hash of every source file that the modules depend on within their package.

    Parameters
    ----------
    package : str
        The stages' package; imports from elsewhere are libraries or the pipeline.
    modules : sequence of str
        A stage's module, and that of the object it asks for, which may lie outside the package; then what it imports
        from its own package counts, too.

    Returns
    -------
    dict of str to str
        File, relative to the folder that holds the package, to SHA-256.
    """
    root = _package_folder(package).parents[package.count(".")]
    return {_relative(path, root): hash_file(path) for path in _closure(package, tuple(modules))}


def library_versions(package: str, modules: Sequence[str]) -> dict[str, str]:
    """Return the version of Python and of every library that the modules' sources import."""
    names = {name.split(".")[0] for path in _closure(package, tuple(modules)) for name in _imports(path)}
    outside = names - set(sys.stdlib_module_names) - {package.split(".")[0], "pipeline"}
    versions = {"python": platform.python_version()}
    for name in sorted(outside):
        version = _version(name)
        if version:
            versions[name] = version
    return versions


@cache
def _closure(package: str, modules: tuple[str, ...]) -> tuple[Path, ...]:
    found: set[Path] = set()
    waiting = [path for module in modules for path in _files_of(package, module)]
    beside = tuple(f"{module.rpartition('.')[0]}." for module in modules if not module.startswith(f"{package}."))
    while waiting:
        path = waiting.pop()
        if path in found:
            continue
        found.add(path)
        for name in _imports(path):
            if name.startswith((f"{package}.", *beside)):
                waiting.extend(_files_of(package, name))
    return tuple(sorted(found))


@cache
def _files_of(package: str, module: str) -> tuple[Path, ...]:
    folder = _package_folder(package)
    if module.startswith(f"{package}."):
        first = module.removeprefix(f"{package}.").split(".")[0]
        if (folder / first).is_dir():
            return _folder_files(folder / first)
        return (folder / f"{first}.py",) if (folder / f"{first}.py").exists() else ()
    try:
        spec = importlib.util.find_spec(module)
    except ModuleNotFoundError:  # a name within a module
        return ()
    return (Path(spec.origin),) if spec and spec.origin and spec.origin.endswith(".py") else ()


@cache
def _folder_files(folder: Path) -> tuple[Path, ...]:
    return tuple(sorted(folder.rglob("*.py")))


@cache
def _package_folder(package: str) -> Path:
    spec = importlib.util.find_spec(package)
    if spec is None or not spec.submodule_search_locations:
        raise ModuleNotFoundError(f"no package {package}")
    return Path(next(iter(spec.submodule_search_locations)))


def _relative(path: Path, root: Path) -> str:
    return path.relative_to(root).as_posix() if path.is_relative_to(root) else path.name


@cache
def _imports(path: Path) -> tuple[str, ...]:
    return tuple(_walk_imports(ast.parse(path.read_bytes())))


def _walk_imports(node: ast.AST) -> Iterator[str]:
    if isinstance(node, ast.Import):
        yield from (each.name for each in node.names)
    elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
        yield node.module
        yield from (f"{node.module}.{each.name}" for each in node.names)
    for field in ("body", "orelse", "handlers", "finalbody", "cases"):  # an import is a statement, and within these
        held = getattr(node, field, ())
        for each in held if isinstance(held, list) else ():
            yield from _walk_imports(each)


@cache
def _version(name: str) -> str | None:
    for distribution in (name, {"sklearn": "scikit-learn"}.get(name, name)):
        try:
            return importlib.metadata.version(distribution)
        except importlib.metadata.PackageNotFoundError:
            continue
    return None
