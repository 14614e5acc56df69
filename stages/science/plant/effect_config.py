"""What plants have in common: nominal constants with tolerances, and entries of their lists of effects.

A section of YAML flows in; checked values come out.
"""

from collections.abc import Mapping
from typing import Any, ClassVar, Self

from pydantic import BaseModel, Field, model_serializer, model_validator

from stages.science.plant.declaration import Declared, nearest
from stages.science.plant.effect import Effect, Parameter, find_effect, list_forms, name_module


class NominalConstant(Declared):
    """A constant of the textbook model: where a fit begins, and how far it may go; null for the data's own."""

    unit: str
    start: float | None
    low: float | None
    high: float | None
    sd: float | None = Field(description="standard deviation of the prior about the start")

    @model_validator(mode="after")
    def _check_order(self) -> Self:
        known = [each for each in (self.start, self.low, self.high, self.sd) if each is not None]
        if not known:
            return self
        if len(known) < 4:
            raise ValueError("expected start, low, high and sd, or null for all of them")
        start, low, high, sd = known
        if not low <= start <= high or low == high or sd <= 0.0:
            raise ValueError(f"expected low <= start <= high, low < high and sd > 0, got {low}, {start}, {high}, {sd}")
        return self

    def with_defaults(self, start: float, low: float, high: float, sd: float) -> Self:
        """Return the constant with these, where it has none of its own."""
        if self.start is not None:
            return self
        return self.model_copy(update={"start": min(max(start, low), high), "low": low, "high": high, "sd": sd})

    def as_parameter(self, name: str, description: str) -> Parameter:
        """Return what a fit takes; a `ValueError` says that its bounds are open."""
        if self.start is None or self.low is None or self.high is None or self.sd is None:
            raise ValueError(f"constant {name}: its bounds are the data's own, and there are no data yet")
        return Parameter(name, self.unit, self.low, self.high, self.start, self.sd, description, starts=(self.start,))


def constant(unit: str, description: str) -> Any:
    """Return the declaration of a nominal constant with its unit, which the configuration may then leave out."""
    return Field(description=description, json_schema_extra={"unit": unit})


def infer_from_data(constants: type[BaseModel]) -> dict[str, Any] | None:
    """Return a section that leaves all constants of a model to the data; None where it does not tell their units."""
    told = {name: each.json_schema_extra for name, each in constants.model_fields.items()}
    units = {name: each["unit"] for name, each in told.items() if isinstance(each, dict) and "unit" in each}
    open_values = {"start": None, "low": None, "high": None, "sd": None}
    return {name: {"unit": unit, **open_values} for name, unit in units.items()} if len(units) == len(told) else None


def check_parameters(effect: Effect, values: Mapping[str, Any]) -> dict[str, float]:
    """Return an effect's parameters as floats, in declared order.

    A `ValueError` tells one that is unknown, missing though not optional, no number or out of bounds.
    """
    declared = {parameter.name: parameter for parameter in effect.parameters}
    for name in values:
        if name not in declared:
            raise ValueError(f"effect {effect.name} has no parameter '{name}': {nearest(str(name), declared)}")
    checked = {}
    for name, each in declared.items():
        unit = "" if each.unit == "1" else each.unit
        if name not in values and each.optional:
            continue
        if name not in values:
            told = f"{each.description}, {unit}" if unit else each.description
            raise ValueError(f"effect {effect.name}: missing parameter '{name}' ({told})")
        value = values[name]
        number = isinstance(value, int | float) and not isinstance(value, bool)
        if not number or not each.low <= value <= each.high:
            raise ValueError(
                f"effect {effect.name}, {name}: expected a number from {each.low} to {each.high}"
                f"{unit and ' '}{unit}, got {value!r}; change it in the list plant.effects"
            )
        checked[name] = float(value)
    return checked


class EffectConfig(Declared):
    """One entry of a plant's list: an effect by name, its form and its parameters, written flat in YAML.

    `form` is the first that acts at the plant's site, where the entry does not say.
    """

    SITE: ClassVar[str]

    name: str
    form: str
    parameters: dict[str, float]

    @model_validator(mode="before")
    @classmethod
    def _read(cls, entry: Any) -> Any:
        if not isinstance(entry, Mapping) or "parameters" in entry:
            return entry
        if "name" not in entry:
            raise ValueError("an effect needs a name")
        effect = find_effect_at(cls.SITE, str(entry["name"]), entry.get("form"))
        numbers = {key: value for key, value in entry.items() if key not in ("name", "form")}
        return {"name": effect.name, "form": effect.form, "parameters": check_parameters(effect, numbers)}

    @model_serializer
    def _write(self) -> dict[str, Any]:
        return {"name": self.name, "form": self.form, **self.parameters}

    @property
    def effect(self) -> Effect:
        """The effect itself."""
        return find_effect(self.name, self.form)

    @property
    def imported_by_name(self) -> tuple[str, ...]:
        """Module of the effect."""
        return (name_module(self.name),)


def list_effects_at(site: str, names: Any) -> list[Effect]:
    """Return the forms of some effects that act at a site."""
    return [effect for name in names for effect in list_forms(name) if effect.site == site]


def find_effect_at(site: str, name: str, form: str | None) -> Effect:
    """Return an effect that acts at a site, in the form given or its first; a `ValueError` says that there is none."""
    for effect in list_forms(name) if form is None else (find_effect(name, form),):
        if effect.site == site:
            return effect
    article = "an" if site[0] in "aeio" else "a"
    raise ValueError(f"effect {name}{f', form {form},' if form else ''} does not act at {article} {site}")
