"""Hysteresis: what a muscle pulls, or a regulator holds, depends on the way it came and not on its speed.

In the braid threads rub on threads, so a muscle pulls less while it shortens than while it lengthens. The forms differ
in what the loop scales with and in how it turns: `maxwell_slip` (operators of equal force) and `bouc_wen` (a smooth
turn) with the force that the pressure would give at rest length, `prandtl_ishlinskii` (operators of equal stiffness)
with nothing, `force_scaled` with the force itself. `regulator` is a play between command and pressure.
"""

from dataclasses import replace

import numpy as np

from stages.science.effects import name_terms, take_share
from stages.science.plant.effect import Bench, ChainEffect, DynamicEffect, ElementEffect, Parameter, State, Values
from stages.science.signals.operators import follow_bouc_wen, follow_play, follow_stops
from stages.science.signals.trajectories import Array

ELEMENTS = 4


def _spread(width: float) -> Array:
    return width * np.arange(1, ELEMENTS + 1) / ELEMENTS


def _slip(state: State, parameters: Values) -> Array:
    return follow_stops(state.contraction, _spread(parameters["width"]))


def _hold_by_plays(state: State, parameters: Values) -> Array:
    radii = _spread(parameters["width"])
    held = np.zeros_like(state.contraction)
    for radius in radii:
        held += state.contraction - follow_play(state.contraction, radius)
    return held / radii.sum()


def _share_of(what: str) -> Parameter:
    return Parameter("share", "1", 0.0, 0.3, 0.03, 0.03, f"friction over {what}", (0.03, 0.12))


WIDTH = Parameter(
    "width", "1", 0.004, 0.1, 0.02, 0.01, "contraction over which the widest element turns", (0.008, 0.03)
)

EFFECT = ChainEffect(
    name="hysteresis",
    form="maxwell_slip",
    site="muscle",
    signal="force_n",
    parameters=(_share_of("the force at this pressure and rest length"), WIDTH),
    source=(
        "Vo-Minh, Tjahjowidodo, Ramon, Van Brussel, A new approach to modeling hysteresis in a pneumatic artificial "
        "muscle using the Maxwell-slip model, IEEE/ASME Trans. Mechatronics 16 (2011)"
    ),
    signature="a loop of force over contraction, whatever the speed, that turns within a small way after each reversal",
    split_by="small reversals inside a large one, slow, at constant pressure",
    apply=take_share(_slip, at_pressure=True),
)

BOUC_WEN_SPRING = DynamicEffect(
    name="hysteresis",
    form="bouc_wen_spring",
    site="motion",
    parameters=(
        Parameter("share", "1", 0.0, 3.0, 0.0, 0.2, "deceleration, scales per squared pace", (0.1,)),
        Parameter("turning", "1", 0.02, 2.0, 0.3, 0.2, "motion over which it turns, in scales", (0.2, 0.6)),
    ),
    source="Wen, Method for random vibration of hysteretic systems, ASCE J. Eng. Mech. Div. 102 (1976)",
    signature="force over motion makes a loop that does not shrink with speed",
    split_by="a very slow cycle to both ends, twice as far the second time",
    terms=name_terms(hysteretic="share", turning="turning"),
)


def _apply_two_plays_to_element(answer: Array, bench: Bench, parameters: Values) -> Array:
    first, second = (_stop_from(bench, parameters[width], parameters["begun"]) for width in ("width", "second_width"))
    return answer + parameters["share"] * (first + parameters["second_ratio"] * second)


def _stop_from(bench: Bench, width: float, begun: float) -> Array:
    before = bench.along[:1] - begun * width
    return np.asarray(follow_stops(np.concatenate([before, bench.along]), np.array([width]))[1:])


SLIDING_ELEMENT = ElementEffect(
    name="hysteresis",
    form="element_maxwell_slip",
    parameters=(
        Parameter("share", "1", -2.0, 2.0, 0.0, 0.3, "half the loop's height over the answer's scale", (0.1, -0.1)),
        Parameter("width", "1", 0.005, 2.0, 0.2, 0.3, "way in which it turns, over the way's scale", (0.03, 0.15, 0.6)),
    ),
    source=EFFECT.source,
    signature="the answer at the same place of its path differs by the way that led there, at any pace",
    split_by="the same loop at three speeds, and small loops inside it",
    apply=lambda answer, bench, parameters: (
        answer + parameters["share"] * follow_stops(bench.along, _spread(parameters["width"]))
    ),
)
PLAYING_ELEMENT = replace(
    SLIDING_ELEMENT,
    form="element_play",
    parameters=(
        *SLIDING_ELEMENT.parameters,
        Parameter("begun", "1", -1.0, 1.0, 0.0, 0.5, "how far it has turned as a record begins", (0.0,)),
    ),
    source="Krasnoselskii, Pokrovskii, Systems with hysteresis, Springer (1989): the stop, complement of the play",
    apply=lambda answer, bench, parameters: (
        answer + parameters["share"] * _stop_from(bench, parameters["width"], parameters["begun"])
    ),
)

TWO_PLAYS_ELEMENT = replace(
    PLAYING_ELEMENT,
    form="element_prandtl_ishlinskii",
    parameters=(
        PLAYING_ELEMENT.parameters[0],
        replace(PLAYING_ELEMENT.parameters[1], starts=(0.15, 0.6)),
        PLAYING_ELEMENT.parameters[2],
        Parameter("second_ratio", "1", -0.4, 3.0, 0.0, 1.0, "height of another slider over the first's", (0.5, -0.3)),
        Parameter("second_width", "1", 0.005, 2.0, 0.5, 0.5, "way in which that turns", (0.4, 0.8)),
    ),
    source=(
        "Lin, Lin, Yu, Chen, Hysteresis modeling and tracking control for a dual pneumatic artificial muscle system "
        "using Prandtl-Ishlinskii model, Mechatronics 28 (2015): play operators of several widths"
    ),
    apply=_apply_two_plays_to_element,
    scales=False,
)

PLAYING_LAG = DynamicEffect(
    name="hysteresis",
    form="lag",
    site="lag",
    parameters=(
        Parameter("half_width", "1", 0.0, 2.0, 0.0, 0.2, "half of the input's way back before it acts", (0.05, 0.2)),
    ),
    source="Krasnoselskii, Pokrovskii, Systems with hysteresis, Springer (1989): the play operator",
    signature="the output settles below the input after a rise and above it after a fall, and ignores small moves",
    split_by="a staircase of inputs up and down, each step held until it settles",
    terms=name_terms(play="half_width"),
)

PLAYING_DRIVE = replace(
    PLAYING_LAG,
    form="drive_play",
    site="motion",
    signature="the motion settles short of where the input puts it, on the side that it comes from",
    terms=name_terms(drive_play="half_width"),
)

FORMS = (
    EFFECT,
    replace(
        EFFECT,
        form="prandtl_ishlinskii",
        parameters=(_share_of("the largest force"), WIDTH),
        source=(
            "Lin, Lin, Yu, Chen, Hysteresis modeling and tracking control for a dual pneumatic artificial muscle "
            "system using Prandtl-Ishlinskii model, Mechatronics 28 (2015)"
        ),
        apply=take_share(_hold_by_plays),
    ),
    replace(
        EFFECT,
        form="bouc_wen",
        parameters=(
            _share_of("the force at this pressure and rest length"),
            replace(WIDTH, low=0.002, starts=(0.004, 0.015)),
        ),
        source="Wen, Method for random vibration of hysteretic systems, J. Eng. Mech. Div. ASCE 102 (1976)",
        apply=take_share(
            lambda state, parameters: follow_bouc_wen(state.contraction, parameters["width"]), at_pressure=True
        ),
    ),
    replace(
        EFFECT,
        form="force_scaled",
        parameters=(_share_of("the force itself"), WIDTH),
        source=(
            "Tondu, Lopez, Modeling and control of McKibben artificial muscle robot actuators, IEEE Control Syst. Mag. "
            "20 (2000): dry friction between threads"
        ),
        apply=lambda signal, state, parameters: signal - parameters["share"] * signal * _slip(state, parameters),
    ),
    replace(
        EFFECT,
        form="regulator",
        site="valve",
        signal="pressure_command_kpa",
        parameters=(
            Parameter("play_kpa", "kPa", 0.0, 100.0, 5.0, 5.0, "command's way before pressure follows", (4.0, 15.0)),
        ),
        source=(
            "Krasnoselskii, Pokrovskii, Systems with hysteresis, Springer (1989): the play operator; regulators' data "
            "sheets state it as hysteresis"
        ),
        signature="pressure settles below the command after a rise and above it after a fall, and ignores small moves",
        split_by="a staircase of commands up and down, each step held until it settles",
        apply=lambda signal, state, parameters: follow_play(signal, parameters["play_kpa"]),
    ),
    BOUC_WEN_SPRING,
    PLAYING_ELEMENT,
    SLIDING_ELEMENT,
    TWO_PLAYS_ELEMENT,
    PLAYING_LAG,
    PLAYING_DRIVE,
)
