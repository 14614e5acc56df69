"""Table 1: the Gaussian hyperpriors of every muscle's model, and the constants that standardise its data.

In: `candidates`, for the range of the inputs (they have no force). Out: `hyperprior` and `scaling`. The force scale
comes from the data sheet.
"""

from collections.abc import Sequence
from typing import Annotated, Any, Self

import pandas as pd
from pydantic import Field, model_validator

from pipeline.config import Section
from pipeline.context import Context
from pipeline.errors import suggest
from pipeline.stage import stage
from pipeline.table import Table, column
from stages.science.muscle_models.inputs import FEATURES, ModelSettings
from stages.science.plant.exoskeleton import MOST_CONTRACTED, Exoskeleton, Muscle
from stages.science.signals.scaling import MODEL_OUTPUT

UNITS = {**{each.column: each.unit for each in FEATURES.values()}, MODEL_OUTPUT: "N"}

CONSTANT_MEAN = "constant_mean"
LENGTHS = {name: f"log_length_{name}" for name in FEATURES} | {"contraction_velocity": "log_length_velocity"}
LOGS = (*LENGTHS.values(), "log_signal_sd", "log_noise_sd")
HYPERPARAMETERS = {**dict.fromkeys(LOGS, "log of standard units"), CONSTANT_MEAN: "standard units"}

HYPERPRIOR = Table(
    "hyperprior",
    "Gaussian hyperprior of one hyperparameter of one muscle (Table 1)",
    {
        "muscle": column(str, "muscle"),
        "hyperparameter": column(str, "in the order of the model's parameter vector"),
        "mean": column(float, "mean of the hyperparameter"),
        "variance": column(float, "variance of the hyperparameter", low=0),
        "unit": column(str, "unit of mean and of the root of the variance"),
        "source": column(str, "where the values come from"),
    },
    key=("muscle", "hyperparameter"),
)
SCALING = Table(
    "scaling",
    "Constants that standardise one quantity of one muscle, fixed before any force is measured",
    {
        "muscle": column(str, "muscle"),
        "quantity": column(str, "column of a recording", among=list(UNITS)),
        "centre": column(float, "subtracted first"),
        "scale": column(float, "divided by then", low=0),
        "unit": column(str, "unit of centre and scale"),
        "source": column(str, "where the values come from"),
    },
    key=("muscle", "quantity"),
)


FOUR_ORDERS, TWO_ORDERS = 9.2, 4.6


class Row(Section):
    """One hyperparameter's prior.

    Data are in standard units, of order one, and log 10^4 is 9.2: a mean beyond it either way is no length, deviation
    or force of such data, and a standard deviation above half of it says nothing within that range. One of 10^-4 holds
    the hyperparameter fixed already.
    """

    mean: Annotated[float, Field(ge=-FOUR_ORDERS, le=FOUR_ORDERS)]
    variance: Annotated[float, Field(ge=1e-8, le=round(TWO_ORDERS**2))]
    source: str


class DataSheet(Section):
    """What the maker promises of a muscle type, within what tables of measurements hold and braided muscles reach."""

    rated_force_n: Annotated[float, Field(ge=1, le=10000)]
    rated_pressure_kpa: Annotated[float, Field(ge=1, le=1000)]
    max_contraction: Annotated[float, Field(gt=0, le=MOST_CONTRACTED)]
    source: str


class Hyperprior(Section):
    """Config group ``hyperprior``: the same rows for all muscles, those that differ, and the force scale's source."""

    rows: dict[str, Row]
    muscles: dict[str, dict[str, Row]]
    data_sheet: dict[str, DataSheet]


class Config(Section):
    """What this stage reads."""

    hyperprior: Hyperprior
    model: ModelSettings
    exoskeleton: Exoskeleton

    @model_validator(mode="after")
    def _match_rows(self) -> Self:
        section, muscles = self.hyperprior, self.exoskeleton.muscles
        for name in section.muscles:
            if name not in self.exoskeleton.muscle_names:
                raise ValueError(
                    f"hyperprior.muscles: no muscle '{name}'; {suggest(name, self.exoskeleton.muscle_names)}"
                )
        for muscle in muscles:
            rows = {**section.rows, **section.muscles.get(muscle.name, {})}
            for name in rows:
                if name not in HYPERPARAMETERS:
                    raise ValueError(f"hyperprior: no hyperparameter '{name}'; {suggest(name, HYPERPARAMETERS)}")
            missing = [name for name in name_hyperparameters(self.model) if name not in (*rows, CONSTANT_MEAN)]
            if missing:
                raise ValueError(f"hyperprior.rows lacks {', '.join(missing)}")
            if muscle.type not in section.data_sheet:
                hint = suggest(muscle.type, section.data_sheet)
                raise ValueError(f"hyperprior.data_sheet has no type '{muscle.type}' of {muscle.name}; {hint}")
            joint = self.exoskeleton.joints[self.exoskeleton.joint_names.index(muscle.joint)]
            longest = min(muscle.contractions_over(joint))
            most = section.data_sheet[muscle.type].max_contraction
            if most <= longest:
                raise ValueError(
                    f"hyperprior.data_sheet.{muscle.type}.max_contraction: expected more than {longest:.3g}, the least "
                    f"contraction of {muscle.name} over its joint's range, so that it pulls somewhere, got {most}; "
                    "raise it"
                )
        return self


@stage(HYPERPRIOR, SCALING)
def hyperprior(cfg: Config, candidates: pd.DataFrame, ctx: Context) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Set out Table 1 and the scaling of every muscle's data."""
    priors, scalings = [], []
    for muscle in cfg.exoskeleton.muscles:
        rows = {**cfg.hyperprior.rows, **cfg.hyperprior.muscles.get(muscle.name, {})}
        priors += [
            (muscle.name, name, rows[name].mean, rows[name].variance, HYPERPARAMETERS[name], rows[name].source)
            for name in name_hyperparameters(cfg.model)
            if name in rows
        ]
        sheet = cfg.hyperprior.data_sheet[muscle.type]
        its = candidates[candidates["muscle"] == muscle.name]
        scalings += scale_muscle(muscle, sheet, its, [each.column for each in cfg.model.features])
    table_1 = pd.DataFrame(priors, columns=list(HYPERPRIOR.columns))
    return table_1, pd.DataFrame(scalings, columns=list(SCALING.columns))


def name_hyperparameters(model: ModelSettings) -> list[str]:
    """Return the names in the order of the model's parameter vector, that of a constant mean last."""
    return [*(LENGTHS[name] for name in model.inputs), "log_signal_sd", "log_noise_sd", CONSTANT_MEAN]


def scale_muscle(
    muscle: Muscle, sheet: DataSheet, candidates: pd.DataFrame, inputs: Sequence[str]
) -> list[tuple[Any, ...]]:
    """Return the rows of `scaling`: inputs by the bank's mean and SD, force by the data sheet over the bank's range.

    The data sheet's force is taken as proportional to pressure and falling linearly to zero at the largest contraction.
    The centre is that force at the bank's mean state, the scale a quarter of it at the strongest state of the bank.
    """
    rows = []
    for name in inputs:
        values = candidates[name]
        centre, spread = float(values.mean()), float(values.std(ddof=0))
        source = "mean and SD over the bank" if spread > 0 else "mean over the bank, where it is constant"
        rows.append((muscle.name, name, centre, spread or 1.0, UNITS[name], source))
    pressure, contraction = candidates["pressure_kpa"], candidates["contraction"]
    per_kpa = sheet.rated_force_n / sheet.rated_pressure_kpa
    centre = per_kpa * pressure.mean() * (1 - contraction.mean() / sheet.max_contraction)
    strongest = per_kpa * pressure.max() * (1 - contraction.min() / sheet.max_contraction)
    source = f"force at the bank's mean state, a quarter of that at its strongest; {sheet.source}"
    rows.append((muscle.name, MODEL_OUTPUT, centre, strongest / 4, UNITS[MODEL_OUTPUT], source))
    return rows
