"""The verdict in an engineer's words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

SHORT = {"force_n": "force", "pressure_kpa": "pressure"}
UNITS = {"force_n": "N", "pressure_kpa": "kPa"}


def tell(verdict: Mapping[str, Any], places: Sequence[Mapping[str, Any]], splits: Mapping[str, str]) -> list[str]:
    """Return the verdict as sentences.

    Parameters
    ----------
    verdict : mapping
        As kept in verdict.json.
    places : sequence of mapping
        Rows of the table `gap` that tell where, the largest share first.
    splits : mapping of str to str
        For each name, the experiment that would tell it from its relatives.
    """
    gap = verdict["gap"]
    sentences = [_tell_place(places)] if places else []
    if verdict["status"] == "no_discrepancy":
        sentences = [
            f"Nothing that matters is missing: the gap on trials that were not fitted is {_percent(gap['before'])}, "
            f"the noise floor {_percent(gap['noise_floor'])}."
        ]
    elif verdict["status"] == "named":
        sentences += [_tell_effect(each, verdict["ranking"], splits) for each in verdict["effects"]]
        sentences.append(
            f"With {'it' if len(verdict['effects']) == 1 else 'them'} the gap on trials that were not fitted falls "
            f"from {_percent(gap['before'])} to {_percent(gap['after'])} ({_percent(gap['low'])} to "
            f"{_percent(gap['high'])}; p = {gap['p_value']:.3g}); the noise floor is {_percent(gap['noise_floor'])}."
        )
    else:
        best = [each for each in verdict["ranking"] if each["name"] not in ("none", "unknown")]
        nearest = f" The nearest candidate is {best[0]['name'].replace('_', ' ')}, which is not enough." if best else ""
        sentences.append(
            f"No effect of the library explains this gap: a flexible model still takes away "
            f"{_percent(verdict['unexplained_share'])} of it.{nearest} Gap on trials that were not fitted "
            f"{_percent(gap['before'])}, noise floor {_percent(gap['noise_floor'])}."
        )
    if verdict["absorbed"]:
        names = ", ".join(each.replace("_", " ") for each in verdict["absorbed"])
        sentences.append(f"Not to be told from the nominal constants with these data: {names}.")
    return sentences


def _tell_place(places: Sequence[Mapping[str, Any]]) -> str:
    first = places[0]
    same = [each for each in places if each["channel"] == first["channel"]]
    muscles = sorted({each["muscle"] for each in same})
    channel, unit = SHORT.get(first["channel"], first["channel"]), UNITS.get(first["channel"], "")
    largest = max(each["largest"] for each in same)
    return (
        f"{_join(muscles)}: {channel} is off by up to {largest:.2g} {unit}, most of all at {first['regime']} "
        f"({_percent(first['share_of_gap'])} of the gap in {_percent(first['share_of_time'])} of the time)."
    )


def _tell_effect(effect: Mapping[str, Any], ranking: Sequence[Mapping[str, Any]], splits: Mapping[str, str]) -> str:
    name = effect["name"].replace("_", " ")
    others = [each for each in ranking if each["name"] not in (effect["name"], "none", "unknown")]
    second = f"; {others[0]['name'].replace('_', ' ')} is next at {others[0]['probability']:.2f}" if others else ""
    text = f"On {_join(effect['muscles'])} this is {name} ({effect['probability']:.2f}{second})."
    if effect["indistinguishable_from"]:
        like = " or ".join(each.replace("_", " ") for each in effect["indistinguishable_from"])
        text += f" These data do not exclude {like}; what would: {splits.get(effect['name'], 'other excitation')}."
    return text


def _percent(value: float) -> str:
    return f"{100.0 * value:.2g} %"


def _join(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
