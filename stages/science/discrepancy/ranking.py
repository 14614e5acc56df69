"""What a search found, as rows: its rounds, the effects that it named, the values at each step."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from stages.science.discrepancy.decision import Decision
from stages.science.discrepancy.evidence import NONE
from stages.science.discrepancy.fitted_channel import Fitted
from stages.science.discrepancy.naming import Named, Round
from stages.science.discrepancy.search import Search

UNKNOWN = "unknown"


def rank_first(found: Search, decision: Decision, most_confounded: float) -> list[dict[str, Any]]:
    """Return a row for each candidate of each round of an ended search, the most probable first.

    By its doubts a decision takes a share of every name; of the likeliest, where nothing and no family is likelier, as
    much as is left over by the others, as in `Named.doubt`. By what it holds for unknown it takes a share of nothing.
    ``unknown`` has what is taken. `most_confounded` is the share of an effect's change that the constants may imitate.
    """
    channels = [state.output.channel for state in found.outputs]
    rows = []
    for number, (looked, doubt) in enumerate(zip(found.rounds, decision.doubts, strict=True), start=1):
        verdicts = looked.verdicts
        beside = dict.fromkeys(verdicts.names, max(doubt.values()))
        beside |= {name: doubt[channels[int(np.argmax(its))]] for name, its in verdicts.carries.items()}
        beside |= dict.fromkeys(verdicts.families, 0.0) | {NONE: decision.unknown}
        names = {name: (1.0 - beside[name]) * its for name, its in verdicts.names.items()}
        first = max(verdicts.names, key=verdicts.names.__getitem__)
        if first not in (NONE, *verdicts.families):
            names[first] = min(verdicts.names[first], 1.0 - beside[first])
        names = {name: min(its, 1.0) for name, its in names.items()}
        names[UNKNOWN] = max(1.0 - sum(names.values()), 0.0)
        for name in sorted(names, key=lambda name: -names[name]):
            confounded = float(min(max(looked.confounded_with_constants.get(name, 0.0), 0.0), 1.0))
            as_now = NONE if name == UNKNOWN else name
            rows.append(
                {
                    "round": number,
                    "name": name,
                    "form": ",".join(sorted({form for form in looked.verdicts.forms.get(name, []) if form})),
                    "site": looked.sites.get(name, ""),
                    "probability": names[name],
                    "heldout_gap": looked.heldout[as_now],
                    "gap_over_floor": looked.gaps[as_now],
                    "absorbed_share": confounded,
                    "absorbed": confounded > most_confounded,
                }
            )
    return rows


def list_named(named: Sequence[Named], looked: Sequence[Round]) -> list[dict[str, Any]]:
    """Return a row for each effect and each muscle that carries it, in the order of addition.

    The round of an effect is that of those `looked` that named it, 0 where exact values show it.
    """
    rounds = {_identify(each.named): number for number, each in enumerate(looked, start=1) if each.named}
    return [
        {
            "order": order,
            "round": rounds.get(_identify(each), 0),
            "name": each.name,
            "form": form,
            "site": each.site,
            "channel": each.channel,
            "muscle": muscle,
            "probability": min(each.probability, 1.0),
            "shown": each.shown,
            "p_value": each.p_value,
            "indistinguishable_from": ",".join(each.alternatives),
        }
        for order, each in enumerate(named, start=1)
        for muscle, form in zip(each.elements, each.forms, strict=True)
    ]


def _identify(named: Named) -> tuple[Any, ...]:
    return named.name, named.channel, named.elements


def list_steps(steps: Sequence[Sequence[Fitted]]) -> list[tuple[Any, ...]]:
    """Return every value of every output after each addition, in the order of the columns of the table `steps`."""
    rows: list[tuple[Any, ...]] = []
    for step, fits in enumerate(steps):
        for each in fits:
            output = each.fit.model.output
            constants, effects = each.fit.model.name_values(each.fit.values)
            for effect, form, values in [("", "", constants), *((form.name, form.form, own) for form, own in effects)]:
                rows += [(step, output.channel, output.element, effect, form, *own) for own in values.items()]
    return rows
