"""Options of a config group that lie in files of one's own: ``GROUP=FILE.yaml``.

The command line flows in. Out flows one that Hydra understands, as Hydra takes no path for a group's option: each file
is read and stored as an option of its group. What was read is told with its hash, for the ledger.
"""

import re
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any

from hydra.core.config_store import ConfigStore
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException
from yaml import YAMLError

from pipeline.errors import ConfigError
from pipeline.files import hash_file

SUFFIXES = (".yaml", ".yml")
OVERRIDE = re.compile(r"(?P<group>\+{0,2}(?P<name>[\w/]+)(?:@[\w.:]+)?)=(?P<value>.*)", re.DOTALL)
PACKAGE = re.compile(r"^#\s*@package\s+(\S+)", re.MULTILINE)


def read_choices(arguments: Sequence[str], groups: Collection[str]) -> tuple[list[str], dict[str, dict[str, str]]]:
    """Store every file that the command line names as an option of one of the config groups.

    Out flow the arguments with options in place of files and, by option, the group, the file as typed, and its SHA-256.
    """
    files: dict[str, dict[str, str]] = {}
    replaced = list(arguments)
    for place, argument in enumerate(arguments):
        found = OVERRIDE.fullmatch(argument)
        if not found or found["name"] not in groups:
            continue
        values = [each.strip().strip("'\"") for each in found["value"].split(",")]
        if any(each.endswith(SUFFIXES) for each in values):
            options = [_store(found["name"], each, files) if each.endswith(SUFFIXES) else each for each in values]
            replaced[place] = f"{found['group']}={','.join(options)}"
    return replaced, files


def _store(group: str, file: str, files: dict[str, dict[str, str]]) -> str:
    path = Path(file)
    try:
        text = path.read_text(encoding="utf-8")
        node = OmegaConf.create(text)
    except FileNotFoundError:
        raise ConfigError(f"{group}={file}: no such file in {Path.cwd()}") from None
    except (OSError, UnicodeDecodeError) as error:
        told = error.strerror if isinstance(error, OSError) else "not UTF-8 text"
        raise ConfigError(f"{group}={file}: cannot be read ({told})") from None
    except (YAMLError, OmegaConfBaseException) as error:
        mark = getattr(error, "problem_mark", None)
        problem = getattr(error, "problem", None) or (str(error).splitlines() or [type(error).__name__])[0]
        where = f" in line {mark.line + 1}" if mark else ""
        raise ConfigError(f"{group}={file}: expected YAML, got {problem}{where}") from None
    plain: Any = OmegaConf.to_container(node, resolve=False)
    if not isinstance(plain, dict) or list(plain.values()) in ([], [None]):
        raise ConfigError(f"{group}={file}: expected YAML with keys of {group}, got none")
    digest = hash_file(path)
    option = f"{re.sub(r'[^0-9a-zA-Z]', '_', path.stem)}_{digest[:8]}"
    package = PACKAGE.search(text)
    ConfigStore.instance().store(group=group, name=option, node=node, package=package[1] if package else None)
    files[option] = {"group": group, "file": file, "sha256": digest}
    return option
