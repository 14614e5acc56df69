"""``python -m pipeline rerun=RUN``: makes every table of a finished run again, and tells whether the bytes agree.

Nothing is taken over from any run but what real hardware measured, which cannot be made again.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from hydra.core.override_parser.overrides_parser import OverridesParser
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException
from yaml import YAMLError

from pipeline.config import read_study
from pipeline.errors import ConfigError, PipelineError
from pipeline.files import hash_file, hash_json
from pipeline.flat import INCIDENTAL
from pipeline.ledger import FILE_NAME, Ledger
from pipeline.plan import Ingredients, Step, choose_stages, decide, gather
from pipeline.renames import rename
from pipeline.reproducibility import compare_tables, describe_changes
from pipeline.runner import Runner
from pipeline.runs import find_run, live_status
from pipeline.stage import Stage
from pipeline.terminal import open_console

BESIDE = ("outputs", "workers", "figures")
"""Keys that may be typed beside ``rerun=``: they change no table."""


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
        same = sum(each is None for each in tables.values())
        self._say(f"{same} of {len(tables)} tables have the same bytes as in {self.origin.name}")
        if measured:
            self._say(f"  taken over from it, as real hardware measured them: {', '.join(measured)}")
        if same == len(tables):
            return 0
        width = max(len(name) for name, told in tables.items() if told is not None)
        for name, told in tables.items():
            if told is not None:
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
        tables = compare_tables(ledger, self.origin, made)
        changes = list(describe_changes(ledger, self.origin, made))
        self.comparison = {"tables": tables, "measured": measured, "changes": changes}
        ledger.facts["rerun_of"] = {"run": self.origin.name, "folder": str(self.origin.folder)}
        ledger.facts["comparison"] = self.comparison

    def _was_measured(self, stage: Stage, ingredients: Ingredients) -> bool:
        record: Mapping[str, Any] = self.origin.records.get(stage.name, {})
        return ingredients.measured or bool(record.get("measured"))


def rerun(arguments: Sequence[str], config_folder: Path) -> int:
    """Run a command line with ``rerun=RUN``; return 0 if all tables agree, 1 if one does not, else as `Runner.run`."""
    name, typed = read_arguments(arguments)
    base = OmegaConf.to_container(OmegaConf.load(config_folder / "config.yaml"), resolve=False)
    assert isinstance(base, dict)
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
