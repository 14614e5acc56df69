"""How well one form reproduces an effect that was simulated elsewhere, without noise.

Two outputs of the same dataset, with the effect and without, flow in; out flow the effect's size beyond the nominal
constants and what the fitted form leaves of it.
"""

from __future__ import annotations

import numpy as np

from stages.science.discrepancy.screening import screen
from stages.science.output_channels.fitting import Fit, Model, fit
from stages.science.output_channels.noise import Noise
from stages.science.output_channels.output_channel import EffectForm, OutputChannel

FINE = 1e-3
"""Standard deviation over the range by which noise-free records are fitted; small, so that priors hardly matter."""
STEPS = 40


def explain_exactly(form: EffectForm, with_it: OutputChannel, without: OutputChannel) -> tuple[float, float]:
    """Return an effect's size and what a form leaves of it, root mean squares over the range.

    Parameters
    ----------
    form : EffectForm
        Offered by the output.
    with_it, without : OutputChannel
        Of one dataset without noise, with the effect and without.

    Notes
    -----
    What the nominal model itself leaves without the effect, as of filters and geometry, is taken off both residuals.
    """
    noise = Noise(FINE * with_it.range, 1e-12, 0.03, 1e-12, 1.0)
    nominal, plain = (fit(Model(output), noise, Model(output).start, STEPS) for output in (with_it, without))
    effect = _differ(nominal, plain)
    promised = screen(nominal, noise, [form])
    if not promised:
        return effect, effect
    added = [promised[0].start[each.name] for each in form.parameters]
    amended = fit(Model(with_it, (form,)), noise, np.concatenate([nominal.values, added]), STEPS)
    return effect, min(_differ(amended, plain), effect)


def _differ(first: Fit, second: Fit) -> float:
    output = first.model.output
    difference = (first.residual - second.residual)[output.present]
    return float(np.sqrt((difference**2).mean()) / output.range)
