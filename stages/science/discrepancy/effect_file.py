"""An effect of the user's own, written from the formula of what is left, as a file that the next run can rank.

Descriptions of what is left flow in; the text of a Python file flows out, or why there is none.
"""

from collections.abc import Sequence

from stages.science.discrepancy.description import Description
from stages.science.plant.element_plant import ElementPlant
from stages.science.plant.learned_map import SESSION_TIME, TIME
from stages.science.plant.plant import Plant
from stages.science.plant.record_plant import RecordPlant
from stages.science.recording.signal_names import name_signal
from stages.science.signals.histories import CHANGE, DISTANCE, RECENT

DIGITS, WIDEST = 8, 120
"""Significant digits of numbers in a file, and characters of its lines, as the project's own."""
FAR = 5.0
"""Times the fitted size, and part, that its bounds are."""
OF_MUSCLE = {
    "force_n": {
        "pressure_kpa": "state.command_kpa",
        "contraction": "state.contraction",
        "contraction_velocity_per_s": "state.velocity_per_s",
        "pressure_rate": "np.gradient(state.command_kpa, state.step_s, axis=0)",
    },
    "pressure_kpa": {
        "pressure_command_kpa": "state.command_kpa",
        "command_rate": "np.gradient(state.command_kpa, state.step_s, axis=0)",
    },
}
TIMES_OF_MUSCLE = {
    TIME: "np.repeat(state.time_s[:, None], values.shape[1], axis=1)",
    SESSION_TIME: "state.time_s[:, None] + state.start_s",
}
CALLS = {CHANGE: "change({own}, {paces})", RECENT: "recall({own}, {paces})", DISTANCE: "sum_distance({own}, {step})"}
"""How a file tells the history of a signal."""
HEAD = '''"""{title}

Written by the discrepancy workflow from what no effect explained in {channel} of {element}: about
{formula}
in the units of the recording. It has no cause yet: give it one, and a source.
"""

from collections.abc import Mapping

{numpy}from stages.science.plant.effect import {kinds}Parameter{state}
{histories}from stages.science.signals.trajectories import Array


def apply(values: Array, {seen}: {kind_seen}, parameters: Mapping[str, float]) -> Array:
    """Return the {what} with the formula added: its terms over their usual sizes."""
    x = [
{signals}
    ]
    shape = {shape}
    return values + parameters["{size}"] * shape


EFFECT = {effect}(
    name="{name}",
    form="formula",
{place}    parameters=(
{parameters}
    ),
    source="TO DO: where the form comes from, with the year; so far it is a fit of what was left",
    signature="{channel} errs by a formula of {inputs}",
    split_by="TO DO: the experiment that distinguishes it from others",
    apply=apply,
)

FORMS = (EFFECT,)
'''


def choose_formula(described: Sequence[Description]) -> Description | None:
    """Return what is left that a confirmed formula tells best, or None without one."""
    told = [each for each in described if each.is_confirmed and each.sketch.terms and each.sketched.low > 0.0]
    return max(told, key=lambda each: each.sketched.value, default=None)


def write_effect(name: str, described: Description, plant: Plant | RecordPlant) -> str:
    """Return a Python file with an effect of a name: the formula, its terms over their root mean squares.

    Its parameters are the size, zero for none, and the part of each further term, with the fitted values as starts.

    Raises
    ------
    ValueError
        When no effect can see what the formula is of, or its answer is a motion.
    """
    sketch, output = described.sketch, described.output
    inputs = described.dependence.inputs
    element = plant if isinstance(plant, ElementPlant) else None
    if not all(sketch.code) or (isinstance(plant, RecordPlant) and element is None):
        raise ValueError(
            "effects of this machine are terms of its equation of motion, which a formula of signals is not"
        )
    seen = "state" if element is None else "bench"
    pace = "1.0" if element is None else "bench.time_scale_s"
    known = {**OF_MUSCLE[output.channel], **TIMES_OF_MUSCLE} if element is None else _list_known(element)
    signals, used = [], []
    for each in inputs:
        before = next((word for word in CALLS if each.name.startswith(f"{word} ")), "")
        own = each.name.removeprefix(f"{before} ")
        if own not in known:
            raise ValueError(
                f"its formula is of {name_signal(each.name)[0]}, which effects do not see there; they see "
                f"{', '.join(name_signal(word)[0] for word in known)}"
            )
        told, step = known[own], f"{seen}.step_s"
        if before:
            told = CALLS[before].format(own=told, step=step, paces=f"{step} / {pace}")
            used.append(told.partition("(")[0])
        signals.append(f"        {told},  # {each.name}")
    sizes = [weight * size for (_, weight), size in zip(sketch.terms, sketch.sizes, strict=True)]
    terms = [f"{code} / {_round(size)}" for code, size in zip(sketch.code, sketch.sizes, strict=True)]
    parts = [f'parameters["part_{k}"] * {term}' for k, term in enumerate(terms[1:], start=2)]
    unit, scale = (output.unit, 1.0) if element is None else ("1", element.know("output_scale"))
    size = f"size_{output.unit.lower()}" if element is None else "share"
    words = name_signal(output.channel)[0]
    whose = "" if element is None else ", over the answer's scale"
    parameters = [_declare(size, unit, sizes[0] / scale, 0.0, f"usual size of its first term{whose}")]
    parameters += [
        _declare(f"part_{k}", "1", own / sizes[0], own / sizes[0], "usual size of a further term over the first one's")
        for k, own in enumerate(sizes[1:], start=2)
    ]
    site = "muscle" if output.channel == "force_n" else "pressure"
    imported = ", ".join(sorted(set(used)))
    return HEAD.format(
        numpy="import numpy as np\n\n" if any("np." in line for line in (*signals, *terms)) else "",
        title=f"A formula of {', '.join(name_signal(each.name)[0] for each in inputs)}.",
        channel=words,
        element=output.element,
        formula=sketch.formula,
        kinds="ChainEffect, " if element is None else "Bench, ElementEffect, ",
        state=", State" if element is None else "",
        histories=f"from stages.science.signals.histories import {imported}\n" if imported else "",
        seen=seen,
        kind_seen="State" if element is None else "Bench",
        what=words if element is None else "answer, over its scale,",
        signals="\n".join(signals),
        shape=_add([terms[0], *parts]),
        size=size,
        effect="ChainEffect" if element is None else "ElementEffect",
        name=name,
        place=f'    site="{site}",\n    signal="{output.channel}",\n' if element is None else "",
        parameters="\n".join(parameters),
        inputs=" and ".join(name_signal(each.name)[0] for each in inputs),
    )


def _list_known(plant: ElementPlant) -> dict[str, str]:
    """Return what an effect of an element sees, in the recording's units, by name."""
    path = f"{plant.along} - {plant.against}" if plant.against else plant.along
    way = f"{_round(plant.know('along_middle'))} + {_round(plant.know('along_scale'))} * bench.along"
    return {path: way, f"rate of {path}": "bench.rate", SESSION_TIME: "bench.session_s"}


def _declare(name: str, unit: str, fitted: float, mean: float, description: str) -> str:
    spread = abs(fitted)
    numbers = (_round(each) for each in (-FAR * spread, FAR * spread, mean, spread))
    told = [f'"{name}"', f'"{unit}"', *numbers, f'"{description}"', f"({_round(fitted)},)"]
    return "\n".join(["        Parameter(", *(f"            {each}," for each in told), "        ),"])


def _add(terms: Sequence[str]) -> str:
    line = " + ".join(terms)
    if len(line) + len("    shape = ") <= WIDEST:
        return line
    return "\n".join(["(", f"        {terms[0]}", *(f"        + {each}" for each in terms[1:]), "    )"])


def _round(value: float) -> str:
    return repr(float(f"{value:.{DIGITS}g}"))
