"""Signals that people and pressures follow, and what is measured from them: trajectories, noise, filters, errors.

Generators and plain numbers flow in, arrays over time come out; time is always the first axis.
"""

from stages.signals.delay import find_delay
from stages.signals.filtering import differentiate
from stages.signals.measures import error_rate, rmse
from stages.signals.pressures import pressure_profiles
from stages.signals.scaling import MODEL_INPUTS, MODEL_OUTPUT, Scaling
from stages.signals.trajectories import reach_postures

__all__ = [
    "MODEL_INPUTS",
    "MODEL_OUTPUT",
    "Scaling",
    "differentiate",
    "error_rate",
    "find_delay",
    "pressure_profiles",
    "reach_postures",
    "rmse",
]
