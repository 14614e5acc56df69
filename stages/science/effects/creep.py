"""Creep of the rubber tube: it resists a quick change more than a lasting one.

A spring in series with a slow damper (a Maxwell element) beside the muscle; after a reach the force drifts back for
seconds. `pressure_scaled` has an element as stiff as the pressure makes the muscle, `two_branches` a second, slower
element, which approximates the logarithmic creep of rubber, and `force_relaxation` lets a share of the force follow
slowly, so that a step of pressure creeps too. In `stress_relaxation` the force itself overshoots after any change, and
the surplus fades with two time constants.
"""

from dataclasses import replace

import numpy as np

from stages.science.effects import take_share
from stages.science.plant.effect import Bench, ChainEffect, ElementEffect, Parameter, State, Values
from stages.science.plant.filters import lag, respond
from stages.science.signals.trajectories import Array


def _hold_one_sample_late(state: State, parameters: Values) -> Array:
    tau = np.full(state.contraction.shape[1], parameters["tau_s"])
    return state.contraction - respond(state.contraction, tau, tau, state.step_s)


def _hold(signal: Array, state: State, parameters: Values) -> Array:
    """Return what a slow element holds of a signal, or two of different time constants on average."""
    slow = lag(signal, parameters["tau_s"], state.step_s)
    if "ratio" not in parameters:
        return signal - slow
    return signal - 0.5 * (slow + lag(signal, parameters["tau_s"] * parameters["ratio"], state.step_s))


def _share_of(what: str) -> Parameter:
    return Parameter("share", "1", 0.0, 2.0, 0.1, 0.1, f"slow stiffness per contraction over {what}", (0.1, 0.5))


TAU = Parameter("tau_s", "s", 0.2, 30.0, 2.0, 2.0, "time constant of the slow element", (0.5, 2.0, 8.0))

EFFECT = ChainEffect(
    name="creep",
    form="maxwell_element",
    site="muscle",
    signal="force_n",
    parameters=(_share_of("the largest force"), TAU),
    source=(
        "Vo-Minh, Kamers, Ramon, Van Brussel, Modeling and control of a pneumatic artificial muscle manipulator joint, "
        "part I, accounting for creep effect, Mechatronics 22 (2012)"
    ),
    signature="force overshoots after a reach and drifts back within seconds, while nothing moves",
    split_by="a step of contraction held for ten seconds at constant pressure",
    apply=take_share(_hold_one_sample_late),
)


def _yield(bench: Bench, tau_s: float, begun: float) -> Array:
    """Return where a slow element is that is a way off its rest at the beginning."""
    since = bench.step_s * np.arange(len(bench.along))[:, None]
    return lag(bench.along, tau_s, bench.step_s) + begun * np.exp(-since / tau_s)


def _apply_to_element(answer: Array, bench: Bench, parameters: Values) -> Array:
    held = bench.along - _yield(bench, parameters["paces"] * bench.time_scale_s, parameters["begun"])
    return answer + parameters["share"] * held


YIELDING_ELEMENT = ElementEffect(
    name="creep",
    parameters=(
        Parameter("share", "1", -5.0, 5.0, 0.0, 0.3, "slow stiffness over the answer's scale", (0.1, -0.1)),
        Parameter("paces", "1", 0.02, 20.0, 1.0, 1.0, "time in which it yields, over the pace", (0.2, 1.0, 4.0)),
        Parameter("begun", "1", -1.0, 1.0, 0.0, 0.3, "way off its rest at the beginning, scales", (0.0,)),
    ),
    source=EFFECT.source,
    signature="the answer goes on changing after motion has ended",
    split_by="a step that is held for ten times as long as a movement takes",
    apply=_apply_to_element,
)


def _apply_two_branches_to_element(answer: Array, bench: Bench, parameters: Values) -> Array:
    tau_s = parameters["paces"] * bench.time_scale_s
    slow, slower = (_yield(bench, tau_s * ratio, parameters["begun"]) for ratio in (1.0, parameters["ratio"]))
    return answer + parameters["share"] * (bench.along - 0.5 * (slow + slower))


TWO_BRANCHES_ELEMENT = replace(
    YIELDING_ELEMENT,
    form="element_two_branches",
    parameters=(
        YIELDING_ELEMENT.parameters[0],
        replace(YIELDING_ELEMENT.parameters[1], starts=(0.2, 1.0)),
        Parameter("ratio", "1", 3.0, 100.0, 10.0, 10.0, "slower over slow time constant", (8.0,)),
        YIELDING_ELEMENT.parameters[2],
    ),
    source=(
        "Ferry, Viscoelastic properties of polymers, 3rd edition (1980), chapter 3: a row of Maxwell elements relaxes "
        "with the logarithm of time"
    ),
    apply=_apply_two_branches_to_element,
    scales=False,
)

FORMS = (
    EFFECT,
    replace(
        EFFECT,
        form="pressure_scaled",
        parameters=(_share_of("the force at this pressure and rest length"), TAU),
        apply=take_share(lambda state, parameters: _hold(state.contraction, state, parameters), at_pressure=True),
    ),
    replace(
        EFFECT,
        form="two_branches",
        parameters=(
            _share_of("the largest force"),
            replace(TAU, high=10.0, prior_mean=1.0, prior_sd=1.0, starts=(0.4, 1.5)),
            Parameter("ratio", "1", 3.0, 30.0, 10.0, 5.0, "slower over slow time constant", (8.0,)),
        ),
        source=TWO_BRANCHES_ELEMENT.source,
        apply=take_share(lambda state, parameters: _hold(state.contraction, state, parameters)),
    ),
    replace(
        EFFECT,
        form="force_relaxation",
        parameters=(Parameter("share", "1", 0.0, 0.9, 0.05, 0.1, "share of force that comes late", (0.05, 0.25)), TAU),
        source=(
            "Fung, Biomechanics: mechanical properties of living tissues, 2nd edition (1993), chapter 7: a relaxation "
            "function on the elastic response"
        ),
        signature="force goes on rising for seconds after a step of pressure, or falling after one of contraction",
        split_by="a step of pressure held for ten seconds at constant contraction",
        apply=lambda signal, state, parameters: signal - parameters["share"] * _hold(signal, state, parameters),
    ),
    replace(
        EFFECT,
        form="stress_relaxation",
        parameters=(
            Parameter("share", "1", 0.0, 2.0, 0.1, 0.2, "share of a change of force that fades", (0.05, 0.3)),
            replace(TAU, low=0.05, high=10.0, prior_mean=0.5, prior_sd=1.0, starts=(0.2, 1.0)),
            Parameter("ratio", "1", 3.0, 100.0, 10.0, 15.0, "slower over slow time constant", (10.0,)),
        ),
        source=(
            "Fung, Biomechanics: mechanical properties of living tissues, 2nd edition (1993), chapter 7: quasi-linear "
            "viscoelasticity, a reduced relaxation function of the elastic response"
        ),
        signature="force overshoots after every change, of pressure too, and fades within seconds",
        split_by="a step of pressure held for ten seconds at constant contraction",
        apply=lambda signal, state, parameters: signal + parameters["share"] * _hold(signal, state, parameters),
    ),
    YIELDING_ELEMENT,
    TWO_BRANCHES_ELEMENT,
)
