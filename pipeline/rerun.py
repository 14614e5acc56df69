"""``python -m pipeline rerun=RUN``: makes every table of a finished run again, and tells whether the bytes agree.

Nothing is taken over from any run but what real hardware measured, which cannot be made again. Bytes decide; rows and
columns are looked at only to say by how much tables differ, and records of both runs to say what could be why.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import pandas as pd
import pyarrow.parquet
from hydra.core.override_parser.overrides_parser import OverridesParser
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException
from yaml import YAMLError

from pipeline.checkout import describe_commit
from pipeline.config import read_study
from pipeline.errors import ConfigError, PipelineError, TableError
from pipeline.files import CONFIG_FOLDER, hash_file, hash_json
from pipeline.flat import INCIDENTAL
from pipeline.ledger import FILE_NAME, Ledger
from pipeline.plan import Ingredients, Step, choose_stages, decide, gather
from pipeline.printing import join_some
from pipeline.renames import rename
from pipeline.runner import Runner
from pipeline.runs import find_run, live_status
from pipeline.stage import Stage
from pipeline.table import read_frame
from pipeline.terminal import open_console

BESIDE = ("outputs", "workers", "figures")
"""Keys that may be typed beside ``rerun=``: they change no table."""
LARGEST_READ = 200_000_000
"""Bytes of a table up to which its values are compared."""
MOST_TOLD = 5
MACHINE = ("model", "processor", "system", "cores")


@dataclass
class Rerun(Runner):
    """A run that makes the tables of another one, `origin`, again."""

    origin: Ledger = field(kw_only=True)
    comparison: dict[str, Any] = field(default_factory=dict)

    @property
    def identity(self) -> str:
        """By which an interrupted repetition of the same run is found again, and taken for nothing else."""
        facts = self.origin.facts
        return hash_json({"of": [facts["identity"], facts["started"], self.origin.name], "study": self.study.identity})

    def prepare(self) -> None:
        """Say which files are no longer what they were; refuse if what hardware measured is not whole."""
        label = self.origin.name
        for stage in choose_stages(self.study, self.stages):
            ingredients = replace(gather(self.study, stage, {}), waiting=stage.reads)
            record = self.origin.records.get(stage.name)
            for each in ingredients.differences(record)["input"] if record else []:
                self._say(f"note: {each} since {label}")
            if self._was_measured(stage, ingredients):
                self._check_measured(stage)
        for given in self.given:
            path = Path(given["file"])
            if not path.is_file() or hash_file(path) != given["sha256"]:
                told = "has other bytes now" if path.is_file() else "is gone"
                self._say(f"note: {given['group']}={path} {told}; what {label} had of it is taken from its config.yaml")

    def _check_measured(self, stage: Stage) -> None:
        record = self.origin.finished(stage.name)
        missing = [each.name for each in stage.writes if record and each.name not in record["tables"]]
        problem = f"{stage.name} is not done in it" if record is None else self.origin.damage(record)
        problem = problem or (f"{stage.name} has no table {missing[0]} in it" if missing else None)
        if problem:
            raise ConfigError(
                f"rerun={self.origin.name}: {problem}; expected what was measured on real hardware to be whole, as it "
                "cannot be made again; restore it"
            )

    def print_comparison(self) -> int:
        """Print what came of it; return the exit code: 0 where all tables agree, else 1."""
        tables, measured = self.comparison["tables"], self.comparison["measured"]
        differing = {name: told for name, told in tables.items() if told is not None}
        same = len(tables) - len(differing)
        self._say(f"{same} of {len(tables)} tables have the same bytes as in {self.origin.name}")
        if measured:
            self._say(f"  taken over from it, as real hardware measured them: {', '.join(measured)}")
        if not differing:
            return 0
        width = max(map(len, differing))
        for name, told in differing.items():
            self._say(f"  {name:<{width}}  {told}")
        changes = self.comparison["changes"]
        self._say("what is not as it was, and may be why:" if changes else "nothing that the ledgers hold tells why")
        for each in changes:
            self._say(f"  {each}")
        return 1

    def _plan(self) -> list[Step]:
        return [Step(each, "run", f"as in {self.origin.name}") for each in choose_stages(self.study, self.stages)]

    def _finished_run(self, steps: Sequence[Step]) -> Ledger | None:
        return None

    def _decide(self, stage: Stage, ingredients: Ingredients, ledger: Ledger) -> Step:
        own = decide(stage, ingredients, [ledger])
        if own.source:
            return own
        if self._was_measured(stage, ingredients):
            return Step(stage, "kept", f"measured in {self.origin.name}, and cannot be made again", self.origin)
        return Step(stage, "run", f"made anew, to compare with {self.origin.name}")

    def _conclude(self, ledger: Ledger) -> None:
        names = [each.name for each in choose_stages(self.study, self.stages)]
        taken = [name for name in names if ledger.records[name]["origin"] != ledger.name]
        made = [name for name in names if name not in taken]
        measured = [table for name in taken for table in ledger.records[name]["tables"]]
        tables = _compare_tables(ledger, self.origin, made)
        changes = list(_describe_changes(ledger, self.origin, made))
        self.comparison = {"tables": tables, "measured": measured, "changes": changes}
        facts = self.origin.facts
        command = facts.get("rerun_of", facts).get("command", facts["command"])  # by which sentences go on
        ledger.facts["rerun_of"] = {"run": self.origin.name, "folder": str(self.origin.folder), "command": command}
        ledger.facts["comparison"] = self.comparison

    def _was_measured(self, stage: Stage, ingredients: Ingredients) -> bool:
        record: Mapping[str, Any] = self.origin.records.get(stage.name, {})
        return ingredients.measured or bool(record.get("measured"))


def rerun(arguments: Sequence[str]) -> int:
    """Run a command line with ``rerun=RUN``; return 0 if all tables agree, 1 if one does not, else as `Runner.run`."""
    name, typed = read_arguments(arguments)
    base: Any = OmegaConf.to_container(OmegaConf.load(CONFIG_FOLDER / "config.yaml"), resolve=False)
    settings = {key: base[key] for key in (*INCIDENTAL, base["interface"])}
    origin = find_origin(str(typed.get("outputs", settings["outputs"])), name)
    values = _read_config(origin)
    kept = {key: values[key] for key in ("figures",) if key in values}
    try:
        study, stages = read_study(OmegaConf.create({**values, **settings, **kept, **typed}))
    except (PipelineError, OmegaConfBaseException) as error:
        raise ConfigError(f"rerun={origin.name}: {error}{_describe_origin(origin)}") from None
    given = origin.facts.get("given", ())
    again = name if Path(name).exists() else origin.name  # as latest is another run then
    retyped = [f"rerun={again}", *(each for each in arguments if each.partition("=")[0] in BESIDE)]
    runner = Rerun(study, stages, retyped, open_console(), given, origin=origin)
    runner.prepare()
    return runner.run() or runner.print_comparison()


def read_arguments(arguments: Sequence[str]) -> tuple[str, dict[str, Any]]:
    """Return which run is meant, and the values of the keys beside; refuse anything else."""
    names, typed = [], {}
    for each in arguments:
        key, sign, value = each.partition("=")
        if key.lstrip("+") == "rerun":
            names.append(value.strip().strip("'\""))
        elif sign and key in BESIDE:
            override = OverridesParser.create().parse_override(each)
            if override.is_sweep_override():
                raise ConfigError(f"{each}: expected one value beside rerun=, got several; leave it out")
            typed[key] = override.value()
        else:
            raise ConfigError(
                f"{each}: expected nothing beside rerun=RUN but {', '.join(f'{known}=' for known in BESIDE)}, as the "
                "configuration is that of RUN; leave it out"
            )
    if len(names) != 1 or not names[0]:
        raise ConfigError("rerun=: expected one run, as rerun=latest; python -m pipeline.review list shows them")
    return names[0], typed


def find_origin(outputs: str, name: str) -> Ledger:
    """Return the run that is meant, which must be done.

    Its name is that of a run, the beginning of one, ``latest``, ``SWEEP/JOB``, or the path of a run's folder.
    """
    path = Path(name).expanduser()
    folder = path.parent if path.is_file() else path
    try:
        origin = find_run(outputs, name)
    except ConfigError:
        if not path.exists():
            raise
        if not (folder / FILE_NAME).is_file():
            raise ConfigError(f"rerun={folder}: expected the folder of a run, got one without {FILE_NAME}") from None
        found = Ledger.read(folder.absolute())
        if found is None:
            raise ConfigError(f"rerun={folder}: {FILE_NAME} cannot be read, or is of another version") from None
        origin = found
    status = live_status(origin)
    if status != "done":
        raise ConfigError(f"rerun={name}: expected a run that is done, got one that is {status}; finish it first")
    return origin


def _read_config(origin: Ledger) -> dict[str, Any]:
    path = origin.folder / "config.yaml"
    if not path.is_file():
        raise ConfigError(f"rerun={origin.name}: there is no {path}, which holds its configuration; restore it")
    try:
        values = OmegaConf.to_container(OmegaConf.load(path), resolve=True)
    except (OSError, ValueError, YAMLError, OmegaConfBaseException) as error:
        told = (str(error).splitlines() or [type(error).__name__])[0]
        raise ConfigError(f"rerun={origin.name}: {path} cannot be read ({told}); restore it") from None
    if not isinstance(values, dict) or "workflow" not in values:
        raise ConfigError(f"rerun={origin.name}: expected {path} to hold a whole configuration, got none; restore it")
    return {str(key): value for key, value in rename(values).items()}


def _describe_origin(origin: Ledger) -> str:
    """Return where and with what code a run ran, if that is not here and with this."""
    git, directory = origin.facts.get("git"), origin.facts.get("directory")
    commit = f" with commit {git['commit'][:10]}" if git else ""
    where = f" in {directory}" if directory and directory != str(Path.cwd()) else ""
    return f"; it ran{where}{commit}" if commit or where else ""


def _compare_tables(now: Ledger, then: Ledger, stages: Sequence[str]) -> dict[str, str | None]:
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


def _describe_changes(now: Ledger, then: Ledger, stages: Sequence[str]) -> Iterator[str]:
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
