"""``python -m pipeline [key=value ...]``: composes the configuration, validates it, plans and runs.

The command line flows in; an exit code flows out: 0 done, 1 a stage failed, 2 the command or configuration is wrong,
3 paused for a person, 130 and 143 stopped by a signal.
"""

import gc
import os
import sys

if __name__ == "__main__":
    from pipeline.command import command_line
    from pipeline.interruption import leave_at_once

    leave_at_once(command_line(sys.argv[1:]))

for _library in ("OMP_NUM", "OPENBLAS_NUM", "MKL_NUM", "VECLIB_MAXIMUM", "NUMBA_NUM"):
    os.environ[f"{_library}_THREADS"] = "1"
os.environ.setdefault("MPLBACKEND", "Agg")
gc.set_threshold(100_000)  # looking for cycles among so many objects that stay took a tenth of a run

import re
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import hydra
from hydra.core.global_hydra import GlobalHydra
from hydra.core.hydra_config import HydraConfig
from hydra.errors import HydraException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from pipeline.command import command_line, put_options_first, read_options
from pipeline.config_files import read_choices
from pipeline.errors import ConfigError, PipelineError, join_lines, suggest
from pipeline.files import CONFIG_FOLDER
from pipeline.interruption import Interrupted, ignore_from_now_on
from pipeline.renames import find_today
from pipeline.terminal import complain


def main() -> int:
    """Run the command line; return the exit code."""
    debugging = "HYDRA_FULL_ERROR" in os.environ
    os.environ["HYDRA_FULL_ERROR"] = "1"
    begun: list[bool] = []
    codes: list[int] = []
    faults: list[PipelineError | OmegaConfBaseException] = []
    typed = sys.argv[1:]
    files: dict[str, dict[str, str]] = {}

    def task(composed: DictConfig) -> None:
        from pipeline.runner import run_study  # --help and a mistyped key need none of what this imports

        begun.append(True)
        try:
            given = [files[each] for each in HydraConfig.get().runtime.choices.values() if each in files]
            overrides = [str(each) for each in HydraConfig.get().overrides.task]
            codes.append(run_study(composed, typed, given, overrides))
        except ConfigError as error:
            faults.append(name_file(error, given))
        except (PipelineError, OmegaConfBaseException) as error:
            faults.append(error)

    try:
        if "--version" in typed:
            print(f"pamid {version('pamid')}")
            return 0
        if any(each.lstrip("+").startswith("rerun=") for each in typed):
            from pipeline.rerun import rerun

            begun.append(True)
            return rerun(typed)
        typed = put_options_first(typed)
        sys.argv[1:], found = read_choices(typed, list_groups(typed))
        files.update(found)
        options = read_options(sys.argv[1:])
        asks = options.help or options.hydra_help or options.cfg or options.info or options.shell_completion
        if options.multirun and not asks:
            from pipeline.sweeps.sweep import name_sweep, run_sweep

            typed, sys.argv[1:] = name_sweep(typed), name_sweep(sys.argv[1:])
            return run_sweep(read_options(sys.argv[1:]).overrides, typed, options.config_dir, files)
        if sys.argv[1:] == options.overrides:
            with hydra.initialize_config_dir(str(CONFIG_FOLDER), version_base="1.3"):
                application: Any = GlobalHydra.instance().hydra
                application.run("config", task, options.overrides)
        else:  # for the sake of options, hydra.main composes all twice
            hydra.main(version_base="1.3", config_path=str(CONFIG_FOLDER), config_name="config")(task)()
        if asks:
            sys.stdout.flush()
        for fault in faults:
            raise fault
    except (HydraException, OmegaConfBaseException, PipelineError) as error:
        if debugging:
            raise
        complain(explain(error))
        return 2
    except Interrupted as stop:
        complain(f"{stop}; to continue, type: {command_line(typed)}")
        return stop.code
    except Exception as error:
        if debugging:
            raise
        if isinstance(error, BrokenPipeError) and not begun:  # whoever read the help has read enough
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            return 0
        if not begun:
            complain(f"{explain(error)}; python -m pipeline --help shows what can be set")
            return 2
        line = f"{type(error).__name__}: {error}".splitlines()[0]
        complain(f"{line}; for the traceback, type: HYDRA_FULL_ERROR=1 {command_line(typed)}")
        return 1
    return max(codes, default=0)


def name_file(error: ConfigError, given: Sequence[Mapping[str, str]]) -> ConfigError:
    """Return the error with the file that gave the group whose key it is about."""
    told = [each["file"] for each in given if re.search(rf"(?<![\w.]){each['group']}\.", str(error))]
    return ConfigError(f"{error} (read from {told[0]})") if told else error


def explain(error: Exception) -> str:
    """Return one line for an error of composition, with the nearest name where one was mistyped."""
    text = str(error)
    if isinstance(error, OmegaConfBaseException):
        from pipeline.config import explain_unresolved

        return explain_unresolved(error)
    override = re.search(r"Error parsing override '([^']*)'", text)
    unquoted = "LexerNoViableAltException" in text or "no viable alternative at input" in text
    if unquoted or (not override and re.match("(mismatched|extraneous) input", text)):
        return "an override has a character that needs quotes: quote its value twice, as in \"outputs='my folder'\""
    if override:
        return f"'{override.group(1)}' is no override: expected key=value, as in seed=1 or 'bank.trajectories=20'"
    if "Config group override must be a string or a list" in text:
        pairs = [each.partition("=")[::2] for each in sys.argv[1:] if "." not in each.partition("=")[0]]
        names = re.compile(r"(?!(null|true|false)$)[a-z]\w*", re.IGNORECASE)
        groups = list_groups(sys.argv[1:])
        wrong = [name for name, value in pairs if value and name in groups and not names.fullmatch(value)]
        name = wrong[0] if wrong else "GROUP"
        return f"{name}: expected the name of a file in conf/{name}/"
    if (merged := re.search(r"Error merging override (\S+)", text)) and error.__cause__:
        return f"{merged.group(1)}: {str(error.__cause__).splitlines()[0]}"
    if several := re.search(r"Ambiguous value for argument '([^']+)'", text):
        return f"{several.group(1)}: several values are a sweep, which is asked for by -m"
    if twice := re.search(r"Multiple values for (\S+)\. To override", text):
        return f"{twice.group(1)}: an option is chosen already; leave out the +, as in {twice.group(1)}=..."
    if unknown := re.search(r"Could not override '([^']+)'", text):
        path, at, package = unknown.group(1).removeprefix("+").partition("@")
        if at:
            return (
                f"{path}@{package}: expected a section that this workflow has, and it has no {package} of its own; "
                f"leave @{package} out, or add the workflow that has one"
            )
        keys_are_set = any(each.lstrip("+").startswith(f"{path}={{") for each in sys.argv[1:])
        if not keys_are_set and (elsewhere := _list_workflows_with(path)):
            for each in sys.argv[1:]:
                chosen = CONFIG_FOLDER / f"{each.replace('=', '/')}.yaml"
                if chosen.is_file() and f"override /{path}:" in chosen.read_text(encoding="utf-8"):
                    return f"{each}: it chooses a {path}, and this workflow has none; leave it out"
            return f"{path}: this workflow has none; these have: workflow={', '.join(elsewhere)}"
        known = _known_keys(path)
        if path.split(".")[-1] in known:
            return f"{path}: a key that is set in it is not there yet; add it as +{path}.KEY=..."
        grows = "." in path and bool(known) and all(each is None or isinstance(each, str) for each in known.values())
        told = _explain_unknown(path, known)
        return f"{told}{' To' if told.endswith('?') else '; to'} add it, type +{path}=..." if grows else told
    option = re.search(r"Could not find '([^']+)'[\s\S]*Available options in '[^']+':\s*([\s\S]*?)(?:\n\S|\Z)", text)
    if option:
        group, _, name = option.group(1).rpartition("/")
        today = find_today("options", f"{group}={name}")
        return f"unknown {group} '{name}': {suggest(name, option.group(2).split(), today)}"
    if unknown_group := re.search(r"Could not (?:override '?([\w/]+)'?\.?\s*No match|find '(\w+)/)", text):
        group = unknown_group[1] or unknown_group[2]
        return f"unknown group '{group}': {suggest(group, _known_keys(''), find_today('keys', group))}"
    return join_lines(text)


def _explain_unknown(path: str, known: Mapping[str, object]) -> str:
    """Return what is wrong with a key: the section that is not there, the option without it, or its last word."""
    if today := find_today("keys", path):
        return f"unknown key '{path}': {suggest(path, known, today)}"
    parts = path.split(".")
    for depth in range(1, len(parts)) if not known else ():
        beside = _known_keys(".".join(parts[:depth]))
        if beside and parts[depth - 1] not in beside:
            return f"unknown key '{'.'.join(parts[:depth])}': {suggest(parts[depth - 1], beside)}"
    told = f"unknown key '{path}': {suggest(parts[-1], known)}"
    files = sorted((CONFIG_FOLDER / parts[0]).glob("*.yaml")) if len(parts) == 2 else []
    others = [each.stem for each in files if parts[1] in (OmegaConf.load(each) or {})]
    return f"{told}; it is a key of {parts[0]}={' or '.join(others)}" if others and "did you mean" not in told else told


def _list_workflows_with(name: str) -> list[str]:
    """Return the workflows that choose an option of a group, or have a key, of that name."""
    files = {each.stem: OmegaConf.load(each) for each in sorted((CONFIG_FOLDER / "workflow").glob("*.yaml"))}
    chosen = {stem: OmegaConf.select(each, "defaults", default=[]) for stem, each in files.items()}
    return [stem for stem in files if name in files[stem] or any(f"/{name}" in each for each in chosen[stem])]


def list_groups(arguments: list[str]) -> list[str]:
    """Return the names of all config groups, those of ``--config-dir`` among them."""
    own = read_options(arguments).config_dir
    folders = [CONFIG_FOLDER, *([Path(own)] if own and Path(own).is_dir() else [])]
    groups = [each for folder in folders for each in folder.iterdir() if each.is_dir() and any(each.iterdir())]
    return [each.name for each in groups if each.name != "hydra"]


def _known_keys(path: str) -> dict[str, object]:
    """Return the keys and values beside the one at `path`, with the groups that the command line chooses."""
    options = read_options(sys.argv[1:])
    typed = {each: each.lstrip("+~").split("=")[0] for each in options.overrides}
    one = [each for each in typed if not options.multirun or not re.search(r",|range\(", each)]
    kept = [each for each in one if typed[each] != path and "." not in typed[each]]
    if options.config_dir:
        kept.append(f"hydra.searchpath=[file://{Path(options.config_dir).resolve()}]")
    GlobalHydra.instance().clear()
    try:
        with hydra.initialize_config_dir(str(CONFIG_FOLDER), version_base="1.3"):
            composed = hydra.compose("config", kept, return_hydra_config=path.startswith("hydra."))
        section = OmegaConf.select(composed, path.rpartition(".")[0])
    except (HydraException, OmegaConfBaseException):
        return {}
    held = OmegaConf.to_container(section, resolve=False) if isinstance(section, DictConfig) else {}
    keys: dict[str, object] = {str(key): value for key, value in dict(held).items()}  # type: ignore[arg-type]
    return keys if "." in path else keys | dict.fromkeys(list_groups(sys.argv[1:]))


if __name__ == "__main__":
    try:
        sys.exit(main())
    finally:
        ignore_from_now_on()
        gc.freeze()  # among all objects once more, at the end, it took a fifth of a run where all is fresh
