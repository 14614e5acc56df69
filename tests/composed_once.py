"""What Hydra makes of a configuration's files and of chosen options is made once, as long as the files are the same.

Values, which differ from command to command, are put into a copy by Hydra itself, as ever.
"""

import io
import os
import pickle
from collections.abc import Hashable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from unittest.mock import patch

from hydra._internal import config_loader_impl
from hydra._internal.config_loader_impl import ConfigLoaderImpl
from hydra._internal.defaults_list import DefaultsList, Overrides
from hydra.core.config_store import ConfigStore

OWN = "pkg://hydra"
"""Where Hydra's own files lie, which stay as they are."""
HYDRA = "hydra"
"""Where names of its packages begin, and of plugins, which it may import anew: classes are kept, not looked up."""
_LISTS: dict[Hashable, bytes] = {}
_COMPOSED: dict[Hashable, bytes] = {}
_TYPES: dict[int, type] = {}
_compose = ConfigLoaderImpl._compose_config_from_defaults_list
_list = config_loader_impl.create_defaults_list


class Pickler(pickle.Pickler):
    """Tells which class of Hydra's it was."""

    def persistent_id(self, each: object) -> int | None:
        if isinstance(each, type) and each.__module__.startswith(HYDRA):
            _TYPES[id(each)] = each
            return id(each)
        return None


class Unpickler(pickle.Unpickler):
    """Finds it again."""

    def persistent_load(self, number: int) -> type:
        return _TYPES[number]


def _dump(made: object) -> bytes:
    kept = io.BytesIO()
    Pickler(kept).dump(made)
    return kept.getvalue()


def _load(kept: bytes) -> Any:
    return Unpickler(io.BytesIO(kept)).load()


@contextmanager
def composing_once() -> Iterator[None]:
    """Have the same files and options composed once."""
    with (
        patch.object(config_loader_impl, "create_defaults_list", _list_once),
        patch.object(ConfigLoaderImpl, "_compose_config_from_defaults_list", _compose_once),
    ):
        yield


def _list_once(repo, config_name, overrides_list, **how) -> DefaultsList:
    """Return which files a command line chooses, and its values."""
    state = _describe(repo)
    asked = {"repo": repo, "config_name": config_name, "overrides_list": overrides_list}
    if state is None:
        return _list(**asked, **how)
    overrides = Overrides(repo=repo, overrides_list=overrides_list)
    values = {id(each) for each in overrides.config_overrides}
    options = tuple(each.input_line for each in overrides_list if id(each) not in values)
    key = (state, config_name, options, *sorted(how.items()))
    if key not in _LISTS:
        made = _list(**asked, **how)
        kept = (made.defaults, made.defaults_tree, made.overrides.known_choices, made.overrides.known_choices_per_group)
        _LISTS[key] = _dump(kept)
        return made
    defaults, tree, overrides.known_choices, overrides.known_choices_per_group = _load(_LISTS[key])
    return DefaultsList(defaults, tree, overrides.config_overrides, overrides)


def _compose_once(loader, defaults, repo):
    """Return what chosen files hold together."""
    state = _describe(repo)
    if state is None:
        return _compose(loader, defaults, repo)
    key = (state, *(tuple(vars(each).items()) for each in defaults))
    if key not in _COMPOSED:
        _COMPOSED[key] = _dump(_compose(loader, defaults, repo))
    return _load(_COMPOSED[key])


def _describe(repo) -> Hashable:
    """Return what a composition depends on beside options, as when files were changed; None where that is unknown."""
    facts: list[Hashable] = []
    for source in repo.get_sources():
        if source.scheme() == "file":
            facts.append((source.provider, source.path, *_list_files(Path(source.path))))
        elif source.scheme() == "structured":
            facts.append((source.provider, *_list_stored(ConfigStore.instance().repo)))
        elif source.full_path().startswith(OWN):
            facts.append((source.provider, source.full_path()))
        else:
            return None
    return tuple(facts)


def _list_files(folder: Path) -> Iterator[Hashable]:
    for place, folders, files in os.walk(folder, followlinks=True):
        folders.sort()
        yield place
        for name in sorted(files):
            found = os.stat(os.path.join(place, name))
            yield name, found.st_ino, found.st_mtime_ns, found.st_size


def _list_stored(tree: dict[str, Any]) -> Iterator[Hashable]:
    for name, each in tree.items():
        yield name
        yield tuple(_list_stored(each)) if isinstance(each, dict) else id(each)
