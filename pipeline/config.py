"""Strict validation of the composed configuration.

The plain mapping that Hydra composed flows in, with the stages of the workflow. Out flows a `Study`: the pipeline's own
settings, and for each stage exactly the sections it declares. Every key must be declared by someone; models have no
defaults of their own, so a value stands in YAML or nowhere.
"""

import dataclasses
import importlib
import importlib.util
import inspect
import re
import typing
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal

import yaml
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import MissingMandatoryValue, OmegaConfBaseException
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, TypeAdapter, ValidationError, field_validator
from pydantic.errors import PydanticSchemaGenerationError

from pipeline.errors import ConfigError, join_lines, suggest
from pipeline.files import CONFIG_FOLDER, hash_json
from pipeline.flat import INCIDENTAL
from pipeline.printing import shorten
from pipeline.renames import find_today
from pipeline.stage import Stage, list_tables, load_stages, order_stages

LONGEST_QUOTE = 80
LONGEST_SWEEP = 100
UNKNOWN = ("extra_forbidden", "unexpected_keyword_argument")
BEGINS_WITH_KEY = r"[\w.]+: "


class View(BaseModel):
    """What a check sees of the configuration: sections that are valid each by itself, or some of their keys."""

    model_config = ConfigDict(extra="ignore", frozen=True, strict=True, allow_inf_nan=False)


class Section(BaseModel):
    """A group of config keys: all required, none unknown, finite numbers, types as written.

    A stage's model may name in `checks` what must fit together beyond the sections that the stage reads. The fields of
    a view are top-level sections; it is validated with the configuration and reaches no stage.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)

    checks: ClassVar[tuple[type[View], ...]] = ()


Text = Annotated[str, Field(min_length=1)]


class Target(BaseModel):
    """A section that names the class it configures under ``_target_``; its other keys are that class's parameters."""

    model_config = ConfigDict(extra="allow", frozen=True, strict=True)

    target: str = Field(alias="_target_")


class Metric(Section):
    """A number that tells a run at a glance, and runs of a sweep from each other: a column of the rows that are meant.

    `where` has values that columns must have, `but` values that they must not have. The `title` is what pages call it.
    """

    title: str = ""
    table: Text
    column: Text
    where: dict[str, Any]
    but: dict[str, Any]
    by: Literal["mean", "max", "min", "sum", "first", "last"]


class Curve(Section):
    """A quantity over another, which runs are compared in: a line for each value of `by`, a band over `repeats`.

    Rows that differ in other columns alone are averaged first. The `title` is what pages call the quantity.
    """

    title: str = ""
    table: Text
    x: Text
    y: Text
    by: list[Text]
    repeats: list[Text]
    where: dict[str, Any]


class Workflow(Section):
    """Which stages, from which package, which tables, numbers and curves tell a run, and what others quote."""

    name: str
    package: str
    stages: Annotated[list[Text], Field(min_length=1)]
    headline: list[str]
    metrics: dict[str, Metric]
    curves: dict[str, Curve]
    quoted: list[str]

    @field_validator("package")
    @classmethod
    def _find_package(cls, package: str) -> str:
        try:
            found = importlib.util.find_spec(package) if all(map(str.isidentifier, package.split("."))) else None
        except ModuleNotFoundError:
            found = None
        if found is None or found.submodule_search_locations is None:
            raise ValueError(f"expected the dotted name of a Python package, got {package!r}")
        return package


def _check_name(value: Any) -> Any:
    """Return a sweep's name if it can be a folder's, and is no other word's or number's."""
    usual = isinstance(value, str) and re.fullmatch(r"\w[\w.-]*", value)
    if value is None or (usual and value != "latest" and len(value) <= LONGEST_SWEEP):
        return value
    raise ValueError(
        f"expected a name of at most {LONGEST_SWEEP} letters, digits, _ . - that is no number and not 'latest', "
        f"as in sweep=night, got {shorten(repr(value), LONGEST_QUOTE)}"
    )


class Tracking(Section):
    """Where runs are copied to for colleagues to see, and how long a command waits for that (s)."""

    uri: Text | None
    experiment: Text
    within_s: Annotated[float, Field(gt=0)]
    largest_file_mb: Annotated[float, Field(gt=0)]

    @field_validator("uri")
    @classmethod
    def _hold_no_secret(cls, uri: str | None) -> str | None:
        if uri is not None and re.match(r"https?://[^/]*@", uri):
            raise ValueError(
                "expected an address without name and password, as a run's folder keeps it; set "
                "MLFLOW_TRACKING_USERNAME and MLFLOW_TRACKING_PASSWORD in the environment instead"
            )
        return uri


class Settings(Section):
    """The keys that the pipeline itself reads; of them, only the seed reaches a stage, if the stage declares it."""

    workflow: Workflow
    seed: Annotated[int, Field(ge=0)]
    stages: list[str] | None
    plan: bool
    workers: Annotated[int, Field(ge=1)] | None
    figures: list[Literal["png", "pdf", "svg"]]
    outputs: Text
    sweep: Annotated[str | None, BeforeValidator(_check_name)]
    on_failure: Literal["continue", "stop"]
    on_finished: Literal["keep", "refresh"]
    interface: Text
    tracking: Tracking | None


@dataclass(frozen=True)
class Study:
    """A validated configuration: what the pipeline reads of it, and the whole, resolved, as plain values."""

    settings: Settings
    values: dict[str, Any]

    @property
    def identity(self) -> str:
        """Hash of everything that says what this study computes: all but what changes no result."""
        incidental = (*INCIDENTAL, self.settings.interface)
        return hash_json({key: value for key, value in self.values.items() if key not in incidental})

    def slice(self, stage: Stage) -> dict[str, Any]:
        """Return the sections that a stage declares, as plain values."""
        return {name: self.values[name] for name in stage.config.model_fields}

    def config(self, stage: Stage) -> BaseModel:
        """Return a stage's configuration as its own model."""
        return stage.config.model_validate(self.slice(stage))

    def target(self, stage: Stage) -> str | None:
        """Return the name of the section through which a stage asks for an outside object, or None."""
        fields = stage.config.model_fields.items()
        return next((name for name, field in fields if field.annotation is Target), None)

    @property
    def has_interface(self) -> bool:
        """Whether people follow the devices of this study through an interface."""
        return self.values.get(self.settings.interface) is not None

    def build(self, section: str) -> Any:
        """Return the object that a ``_target_`` section describes; every key is validated on the way."""
        values = self.values[section]
        if not isinstance(values, Mapping) or not isinstance(values.get("_target_"), str):
            raise ConfigError(f"{section}: expected a section with a _target_ (a class), got {values!r}")
        keys = {name: value for name, value in values.items() if name != "_target_"}
        try:
            return _validate(find_target(values["_target_"]), keys, (section,))
        except PydanticSchemaGenerationError:
            raise ConfigError(
                f"{section}._target_: expected a class whose parameters can be checked (a pydantic model or a "
                f"dataclass), got {values['_target_']}"
            ) from None


def read_study(composed: DictConfig) -> tuple[Study, list[Stage]]:
    """Validate a composed configuration against the stages of its workflow, returned in the order of the data.

    A ConfigError tells the first key that is unknown, missing or wrong, with the nearest known name; a WiringError,
    that the stages do not fit together.
    """
    try:
        values: Any = OmegaConf.to_container(composed, resolve=True, throw_on_missing=True)
    except OmegaConfBaseException as error:
        raise ConfigError(explain_unresolved(error)) from None
    plain = {str(key): value for key, value in values.items()}
    settings = read_settings(plain)
    stages = order_stages(load_stages(settings.workflow.package, settings.workflow.stages))
    return _validate_study(plain, settings, stages), stages


def explain_unresolved(error: OmegaConfBaseException) -> str:
    """Return one line for a value that is missing, or quotes one that is."""
    if isinstance(error, MissingMandatoryValue):
        return f"missing value: set it as {error.full_key}=..."
    if gone := re.search(r"Interpolation key '([^']+)' not found", str(error)):
        return f"missing key '{gone.group(1)}', which other keys quote; leave it in, or change what quotes it"
    return join_lines(str(error))


def read_settings(values: Mapping[str, Any]) -> Settings:
    """Validate the pipeline's own keys."""
    own = {name: values[name] for name in Settings.model_fields if name in values}
    return typing.cast(Settings, _validate(Settings, own, ()))


def read_tracking(name: str, given: Mapping[str, str]) -> Tracking:
    """Return the section that ``tracking=NAME`` chooses, with the values that were given for some of its keys."""
    text = (CONFIG_FOLDER / "tracking" / f"{name}.yaml").read_text(encoding="utf-8")
    return typing.cast(Tracking, _validate(Tracking, {**yaml.safe_load(text), **given}, ("tracking",)))


def _validate_study(values: dict[str, Any], settings: Settings, stages: Sequence[Stage]) -> Study:
    interface = settings.interface
    declared = {*Settings.model_fields, interface, *settings.workflow.quoted}
    declared.update(name for each in stages for name in each.config.model_fields)
    for name in values:
        if name not in declared:
            raise ConfigError(
                f"unknown key {name!r}, which no stage of workflow {settings.workflow.name} reads: "
                f"{suggest(str(name), declared, find_today('keys', str(name)))}"
                f"{f' (~{name} leaves the section out)' if isinstance(values[name], Mapping) else ''}"
            )
    study = Study(settings, values)
    if study.has_interface:
        _validate(Target, values[interface], (interface,))
    checked = set()
    for each in stages:
        missing = [name for name in each.config.model_fields if name not in values]
        if missing:
            raise ConfigError(f"missing key '{missing[0]}', which stage {each.name} reads; set {missing[0]}=...")
        _validate(each.config, study.slice(each), ())
        section = study.target(each)
        if section and section not in checked:
            _check_target(study, section)
            checked.add(section)
    for view in [view for each in stages for view in getattr(each.config, "checks", ())]:
        if all(name in values for name in view.model_fields):
            _validate(view, {name: values[name] for name in view.model_fields}, ())
    _check_names(settings, stages)
    return study


def _check_names(settings: Settings, stages: Sequence[Stage]) -> None:
    workflow, names = settings.workflow, [each.name for each in stages]
    if settings.stages == []:
        raise ConfigError(f"stages: expected at least one, or null for all, got []; choose from: {', '.join(names)}")
    for name in settings.stages or []:
        _check_known(name, names, f"stages: no stage {name!r} in workflow {workflow.name}")
    columns = {name: [*table.columns] for name, table in list_tables(stages).items()}
    for name in workflow.headline:
        _check_known(name, columns, f"workflow.headline: no stage of workflow {workflow.name} writes {name!r}")
    for path, table, named in _list_named_columns(workflow):
        if table in columns:
            _check_known(named, columns[table], f"workflow.{path}: table {table} has no column {named!r}")
            continue
        known = list_tables(load_stages(workflow.package))  # this study has not all
        problem = f"workflow.{path.rpartition('.')[0]}.table: no stage of {workflow.package} writes {table!r}"
        _check_known(table, known, problem)


def _check_known(name: str, known: Collection[str], problem: str) -> None:
    if name not in known:
        raise ConfigError(f"{problem}; {suggest(name, known, find_today('names', name))}")


def _list_named_columns(workflow: Workflow) -> Iterator[tuple[str, str, str]]:
    """Yield the key, the table and the column of each place where the workflow names a column."""
    for name, metric in workflow.metrics.items():
        yield f"metrics.{name}.column", metric.table, metric.column
        yield from ((f"metrics.{name}.where", metric.table, each) for each in metric.where)
        yield from ((f"metrics.{name}.but", metric.table, each) for each in metric.but)
    for name, curve in workflow.curves.items():
        named = {"x": [curve.x], "y": [curve.y], "by": curve.by, "repeats": curve.repeats, "where": [*curve.where]}
        yield from ((f"curves.{name}.{key}", curve.table, each) for key, columns in named.items() for each in columns)


def _check_target(study: Study, section: str) -> None:
    try:
        study.build(section)
    except ConfigError as error:
        text = str(error)
        for name, value in study.values.items():
            if study.values[section].get(name) == value:
                text = text.replace(f"{section}.{name}.", f"{name}.")
        raise ConfigError(text) from None


def find_target(path: str) -> type:
    """Import the class that a ``_target_`` names."""
    module_name, _, class_name = path.rpartition(".")
    if not all(part.isidentifier() for part in path.split(".")):
        raise ConfigError(f"_target_: expected the dotted name of a class, as package.module.Class, got {path!r}")
    try:
        module = importlib.import_module(module_name)
    except (ImportError, ValueError) as error:
        if today := find_today("targets", path):
            raise ConfigError(f"_target_ {path}: {suggest(path, (), today)}") from None
        raise ConfigError(f"_target_ {path}: cannot import {module_name or path} ({error})") from None
    found = getattr(module, class_name, None)
    if not isinstance(found, type):
        names = [name for name, value in vars(module).items() if isinstance(value, type)]
        raise ConfigError(f"_target_ {path}: {module_name} has no class {class_name}; {suggest(class_name, names)}")
    if inspect.isabstract(found):
        raise ConfigError(f"_target_ {path}: expected a class that can be built, got an abstract one")
    return found


def _validate(model: type, values: Any, prefix: tuple[str, ...]) -> Any:
    try:
        return TypeAdapter(model).validate_python(values)
    except ValidationError as error:
        raise ConfigError(_describe(model, error, prefix)) from None


def _describe(model: type, error: ValidationError, prefix: tuple[str, ...]) -> str:
    problems = sorted(error.errors(), key=lambda each: each["type"] not in UNKNOWN)
    first = problems[0]
    location = first["loc"]
    path = ".".join(str(part) for part in (*prefix, *location))
    if first["type"] in UNKNOWN:
        known = _known_names(model, location[:-1])
        text = f"unknown key '{path}': {suggest(str(location[-1]), known, find_today('keys', path))}"
    elif first["type"] in ("missing", "missing_argument"):
        text = f"missing key '{path}': set it in conf/ or as {path}=..."
    elif first["type"] == "value_error":
        told = str(first.get("ctx", {}).get("error", first["msg"]))
        text = f"{path}{'.' if re.match(BEGINS_WITH_KEY, told) else ': '}{told}" if path else told
    else:
        got = shorten(repr(first["input"]), LONGEST_QUOTE)
        text = f"{path}: {first['msg'][:1].lower()}{first['msg'][1:]}, got {got}; "
        text += _remedy(first, path, any(isinstance(part, int) for part in location))
    text = " ".join(text.splitlines())
    return text if len(problems) == 1 else f"{text} (and {len(problems) - 1} more)"


def _remedy(problem: Any, path: str, in_list: bool) -> str:
    context = problem.get("ctx", {})
    if problem["type"] == "literal_error":
        return suggest(str(problem["input"]), re.findall(r"'([^']*)'", context["expected"]) or [context["expected"]])
    if in_list:
        return "change it in conf/"
    if problem["type"] == "string_type" and isinstance(problem["input"], int | float):
        return f"quote it twice, as in \"{path}='{problem['input']}'\""
    example = context.get("ge", {"bool_type": "true", "list_type": "[...]"}.get(problem["type"], "..."))
    return f"set {path}={example}"


def _known_names(model: Any, location: Sequence[str | int]) -> list[str]:
    for part in location:
        fields = _fields(model)
        model = fields[str(part)] if part in fields else next(iter(typing.get_args(model)[-1:]), None)
    return list(_fields(model))


def _fields(annotation: Any) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for each in (annotation, *typing.get_args(annotation)):
        if isinstance(each, type) and issubclass(each, BaseModel):
            found |= {name: field.annotation for name, field in each.model_fields.items()}
        elif isinstance(each, type) and dataclasses.is_dataclass(each):
            found |= typing.get_type_hints(each)
    return found
