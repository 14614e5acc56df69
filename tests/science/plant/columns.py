"""One muscle with trials as columns, as a fit sees it."""

import numpy as np

from stages.science.plant.actuator_path import predict_force, predict_pressure
from stages.science.plant.effect import ChainEffect, list_effects, list_forms
from stages.science.plant.muscle import MuscleConstants
from stages.science.plant.plant import collect_constants
from tests.science.plant.machines import configured

STEP_S = 0.004
CHAIN_FORMS = [
    effect
    for name in list_effects()
    for effect in list_forms(name)
    if isinstance(effect, ChainEffect) and name != "none"
]


def label(effect):
    return f"{effect.name}-{effect.form}"


def constants(columns, muscle="pam1", **changed) -> MuscleConstants:
    """Constants of one muscle, once for each trial."""
    rig = configured()
    index = rig.exoskeleton.muscle_names.index(muscle)
    row = MuscleConstants(
        *(np.full(columns, column[index]) for column in collect_constants(rig.exoskeleton, rig.plant))
    )
    return row._replace(**{name: np.full(columns, float(value)) for name, value in changed.items()})


def begin(effect, **changed):
    """Parameters of an effect at the first start of each, with changes."""
    values = {parameter.name: parameter.starts[0] for parameter in effect.parameters}
    assert set(changed) <= set(values)
    return values | changed


def with_magnitude(effect, magnitude):
    return begin(effect, **{effect.parameters[0].name: magnitude})


def predict(signals, effects, muscle="pam1", site="joint_end", start_s=None):
    """Pressure and force of trials side by side."""
    command, pressure, contraction, velocity = signals
    count = command.shape[1]
    start = np.zeros(count) if start_s is None else start_s
    row = constants(count, muscle)
    return (
        predict_pressure(command, row, effects, STEP_S, start),
        predict_force(pressure, contraction, velocity, row, effects, STEP_S, start, site),
    )


def rough(generator, columns=3, samples=500):
    """Commands and motions that jump about, within what a rig can do."""
    command = np.repeat(generator.uniform(0.0, 300.0, (samples // 20, columns)), 20, axis=0)
    pressure = command + generator.normal(0.0, 20.0, command.shape)
    contraction = 0.1 + 0.1 * np.sin(np.cumsum(generator.normal(0.0, 0.05, command.shape), axis=0))
    velocity = np.gradient(contraction, STEP_S, axis=0)
    return command, pressure, contraction, velocity
