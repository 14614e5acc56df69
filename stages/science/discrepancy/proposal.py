"""Which trial would tell rival names apart: how much better the true one would predict it than the others.

Fits of rivals and other trials of their outputs flow in; for each trial the expected evidence flows out. Each rival
fits its constants anew, as far as the trials that there are leave them free.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from pydantic import Field

from stages.science.discrepancy.evidence import MEMORY, NONE, STATIC_MAP
from stages.science.discrepancy.excitations import list_excitations
from stages.science.discrepancy.fitted_channel import Fitted, FittedChannel
from stages.science.discrepancy.naming import extend
from stages.science.discrepancy.ranking import UNKNOWN
from stages.science.discrepancy.screening import screen
from stages.science.discrepancy.trial_scores import compare_by
from stages.science.output_channels.fitting import Model
from stages.science.output_channels.output_channel import OutputChannel
from stages.science.output_channels.trial_noise import find_directions
from stages.science.plant.declaration import Declared
from stages.science.recording.signal_names import name_signal
from stages.science.signals.trajectories import Array

DIGITS = 3
"""Digits of a probability after a trial up to which trials are alike, so that the evidence decides."""


class ProposalSettings(Declared):
    """How many names are compared, and which kind of trial is chosen."""

    rivals: int = Field(ge=2, le=6)
    least_probability: float = Field(gt=0.0, lt=0.5)
    least_gain: float = Field(ge=0.0, lt=1.0)
    choice: Literal["evidence", "random"]


@dataclass(frozen=True)
class Rival:
    """A name, or none, how probable it is, and the fits of all outputs with it."""

    name: str
    probability: float
    fits: Sequence[Fitted]


class Question(NamedTuple):
    """What is least sure: a round of the search, how many effects stood before it, and probabilities of its rivals.

    The probabilities are scaled to one; `leading` is that of the first before.
    """

    number: int
    standing: int
    rivals: Mapping[str, float]
    leading: float


def choose_round(
    ranking: pd.DataFrame, named: pd.DataFrame, suspected: pd.DataFrame, most: int, least: float
) -> Question | None:
    """Return the round of the search whose name is least sure, with the rivals that `choose_rivals` finds in it.

    Rows are of the tables `ranking`, `named_effects` and `suspected_effects`. Rounds are looked at up to the one after
    the last name that stands, in which more is looked for beside them, and those of suspected names, each of which has
    no effect as its rival. A name that stands by another round is no rival, as both are there, unless these data do not
    exclude it in place of the round's own. Where no round has two rivals there is none.
    """
    added = named[named["round"] > 0].groupby("round")[["name", "indistinguishable_from"]].first()
    found: list[Question] = []
    held = suspected[suspected["round"] > 0].groupby("round")[["name", "probability", "indistinguishable_from"]].first()
    for number in sorted({*range(1, int(max(added.index, default=0)) + 2), *held.index}):
        rows = ranking[(ranking["round"] == number) & (ranking["name"] != UNKNOWN)]
        first, like = [], str(added["indistinguishable_from"].get(number, ""))
        if number in held.index:
            name, probability, like = held.loc[number]
            first = [name, NONE]
            own = float(rows.set_index("name")["probability"][name])
            scaled = rows["probability"] * probability / own if own > 0.0 else probability * (rows["name"] == name)
            scaled = scaled.where(rows["name"] != NONE, 1.0 - scaled[rows["name"] != NONE].sum())
            rows = rows.assign(probability=scaled.clip(lower=0.0))
        alike = [*first, *(like.split(",") if like else [])]
        others = set(added["name"].drop(number, errors="ignore")) - set(alike)
        rivals = choose_rivals(rows[~rows["name"].isin(others)], alike, most, least)
        if len(rivals) > 1:
            leading = float(rows.set_index("name")["probability"][next(iter(rivals))])
            found.append(Question(number, int((added.index < number).sum()), rivals, leading))
    return min(found, key=lambda each: each.leading, default=None)


def choose_rivals(ranking: pd.DataFrame, alike: Sequence[str], most: int, least: float) -> dict[str, float]:
    """Return the probabilities, scaled, of the leading names of a round of the table `ranking` that may be true.

    First is the most probable, then those `alike`, which it does not exclude, then others that have a probability of
    `least`, by it and, of equal ones, by the gap that they leave. Families without a name are no rivals, as they
    predict nothing elsewhere: where one is likelier than every name, no name has a rival.
    """
    nameless = ranking["name"].isin([UNKNOWN, STATIC_MAP, MEMORY])
    if ranking.loc[nameless, "probability"].max() > ranking.loc[~nameless, "probability"].max():
        return {}
    may_be = (ranking["probability"] >= least) | ranking["name"].isin(alike)
    rows = ranking[~nameless & ~ranking["absorbed"] & may_be]
    order = rows.assign(
        likeness=[alike.index(name) if name in alike else len(alike) for name in rows["name"]],
        behind=rows["probability"] < rows["probability"].max(),
    ).sort_values(["behind", "likeness", "probability", "heldout_gap"], ascending=[True, True, False, True])
    first = order.head(most)
    shares = np.maximum(first["probability"].to_numpy(dtype=float), least)
    return dict(zip(first["name"], map(float, shares / shares.sum()), strict=True))


def fit_rival(states: Sequence[FittedChannel], name: str, probability: float) -> Rival:
    """Return the fits of outputs with an effect in the channel where it closes most, each in its best form there."""
    now = [state.current for state in states]
    closed: dict[str, float] = {}
    having = list(now)
    for place, state in enumerate(states):
        forms = [form for form in state.output.forms if form.name == name] if name != NONE else []
        fits = extend(state, screen(state.current.fit, state.noise, forms)) if forms else {}
        best = min(fits.values(), key=lambda each: float(each.raw.sum()), default=state.current)
        gain = np.log(max(float(state.current.raw.sum()), 1e-300) / max(float(best.raw.sum()), 1e-300))
        if gain > 0.0:
            having[place] = best
            closed[state.output.channel] = closed.get(state.output.channel, 0.0) + float(gain)
    channel = max(closed, key=closed.__getitem__, default="")
    places = enumerate(states)
    return Rival(name, probability, [having[k] if state.output.channel == channel else now[k] for k, state in places])


def predict(rival: Rival, place: int, output: OutputChannel) -> tuple[Array, Array]:
    """Return what a rival predicts of an output in other trials, (T, J), and its slopes, (T, J, P)."""
    fitted = rival.fits[place]
    model = Model(output, fitted.forms)
    simulated = model.simulate(fitted.fit.values)
    return simulated, model.differentiate(fitted.fit.values, simulated)


def expect_evidence(rivals: Sequence[Rival], others: Sequence[OutputChannel], largest_jitter: float) -> Array:
    """Return the expected log score of each rival over each other, (R, R, J, C), nats, where the first is the truth.

    J trials of C outputs are in the order of `others`, which stand for the outputs of the fits. What the true one
    predicts is fitted by the other with its constants free: the rest is weighed by the noise that the better of the
    two leaves of trials left out, as so many independent samples as its correlation allows. An offset and a gain of a
    trial, where trials have such, tell nothing.

    Notes
    -----
    Discrimination between models of which each is fitted: Box and Hill, Technometrics 9 (1967); Atkinson and Fedorov,
    Biometrika 62 (1975). Beside Box and Hill, no variance of the true model's own constants is added.
    """
    trials = others[0].trials
    evidence = np.zeros((len(rivals), len(rivals), trials, len(others)))
    for place, output in enumerate(others):
        predicted: dict[int, tuple[Array, Array]] = {}
        first = min((each.fits[place] for each in rivals), key=lambda each: float(each.raw.sum()))
        known = first.fit.model.output
        samples = max(float(known.present.sum()), 1.0)
        scores = compare_by(known, first.residual, largest_jitter)
        weight = scores.effective / samples / max(float(first.raw.sum()) / samples, known.resolution**2, 1e-300)
        for true, other in [(a, b) for a in range(len(rivals)) for b in range(len(rivals)) if a != b]:
            if rivals[true].fits[place] is rivals[other].fits[place]:
                continue
            for each in (true, other):
                if each not in predicted:
                    predicted[each] = predict(rivals[each], place, output)
            apart = predicted[true][0] - predicted[other][0]
            directions = find_directions(predicted[true][0], output)
            shape, slopes = (_take_out(each, directions) for each in (apart[:, :, None], predicted[other][1]))
            left = _fit_away(shape[:, :, 0], slopes, rivals[other].fits[place], weight)
            evidence[true, other, :, place] = 0.5 * left
    return evidence


def _take_out(signals: Array, directions: Array) -> Array:
    """Return signals, (T, J, P), without what lies along the directions of their trials, (J, D, T), of length one."""
    along = np.einsum("jdt,tjp->jdp", directions, signals)
    return signals - np.einsum("jdt,jdp->tjp", directions, along)


def _fit_away(apart: Array, slopes: Array, fitted: Fitted, weight: float) -> Array:
    """Return the weighed squares, (J,), of differences, (T, J), that a model's free values do not take away.

    They are held by their priors and by the trials that the model is fitted to.
    """
    free = np.flatnonzero(fitted.fit.free)
    sd = fitted.fit.model.prior[1][free]
    known = fitted.fit.slopes[:, :, free] * sd
    held = weight * np.einsum("tkp,tkq->pq", known, known) + np.eye(len(free))
    moved = slopes[:, :, free] * sd
    curved = held + weight * np.einsum("tjp,tjq->jpq", moved, moved)
    cross = weight * np.einsum("tjp,tj->jp", moved, apart)
    taken = np.linalg.solve(curved, cross[:, :, None])[:, :, 0]
    left: Array = weight * (apart**2).sum(axis=0) - (cross * taken).sum(axis=1)
    return np.maximum(left, 0.0)


def weigh_rivals(probabilities: Array, evidence: Array) -> Array:
    """Return by trial, (J,), how probable the true rival would be after it, on average over which of them is true.

    Parameters
    ----------
    probabilities : (R,) ndarray
    evidence : (R, R, J) ndarray
        Of `expect_evidence`, of all outputs.
    """
    log_odds = np.log(probabilities)[:, None] - np.log(probabilities)[None] + evidence.transpose(2, 0, 1)
    after = 1.0 / np.exp(-log_odds).sum(axis=2)
    return np.asarray(np.minimum(after @ probabilities, 1.0))


@dataclass(frozen=True)
class Proposed:
    """Kinds of trials, weighed: what each lever does, the outputs in all of them, and what they promise.

    `evidence` is from `expect_evidence`, `probability` from `weigh_rivals`, and `order` lists the trials, best first.
    """

    rivals: Sequence[Rival]
    kinds: Sequence[Mapping[str, str]]
    outputs: Sequence[OutputChannel]
    evidence: Array
    probability: Array
    order: Sequence[int]

    @property
    def expected_now(self) -> float:
        """Expected probability of the true rival, as `probability`, before any of these trials."""
        return sum(each.probability**2 for each in self.rivals)

    @property
    def gain(self) -> float:
        """By how much the best of these trials raises the expected probability of the true rival."""
        return float(self.probability[self.order[0]]) - self.expected_now

    @property
    def mean_evidence(self) -> Array:
        """Expected log score of the true rival over another, mean over all pairs, (J,), nats."""
        mean: Array = self.evidence.sum(axis=3)[_apart(self.rivals)].mean(axis=0)
        return mean

    @property
    def clearest(self) -> int:
        """Place of the output in which rivals differ most in the best trial."""
        return int(np.argmax(self.evidence[_apart(self.rivals)][:, self.order[0]].sum(axis=0)))

    def spell(self, trial: int) -> str:
        """Return what the levers do in a trial, in words."""
        return "; ".join(f"{name_signal(lever)[0]} {kind}" for lever, kind in self.kinds[trial].items())


def _apart(rivals: Sequence[Rival]) -> NDArray[np.bool_]:
    return ~np.eye(len(rivals), dtype=bool)


def _is_usual(recorded: OutputChannel, other: OutputChannel) -> NDArray[np.bool_]:
    """Return in which other trials, (J,), no lever moves faster than it did in recorded ones."""
    seen, moved = recorded.tell_levers(), other.tell_levers()
    slower = [
        np.abs(np.diff(moved[name], axis=0)).max(axis=0) <= np.abs(np.diff(seen[name], axis=0)).max() for name in seen
    ]
    return np.asarray(np.all(slower, axis=0))


def propose(
    states: Sequence[FittedChannel], probabilities: Mapping[str, float], largest_jitter: float, lead_in_s: float = 0.0
) -> Proposed | None:
    """Return the kinds of trials of outputs that go no faster than recorded ones, weighed, each as long as these.

    Rivals are told by their names, with probabilities. What is faster shows what no recorded trial did: a model is not
    known to hold there, whichever name is true. It returns none if all are faster. Levers rest in the lead-in, where
    recorded trials begin with one.
    """
    first = states[0].output
    kinds, shares = list_excitations(first.levers, len(first.measured), first.step_s, first.time_scale_s, lead_in_s)
    recorded = [state.current.fit.model.output for state in states]
    outputs = [each.excite(shares) for each in recorded]
    usual = np.flatnonzero(np.all([_is_usual(*both) for both in zip(recorded, outputs, strict=True)], axis=0))
    if not len(usual):
        return None
    rivals = [fit_rival(states, name, probability) for name, probability in probabilities.items()]
    kinds, outputs = [kinds[k] for k in usual], [each.take(list(usual)) for each in outputs]
    evidence = expect_evidence(rivals, outputs, largest_jitter)
    probability = weigh_rivals(np.array(list(probabilities.values())), evidence.sum(axis=3))
    mean = evidence.sum(axis=3)[_apart(rivals)].mean(axis=0)
    order = np.lexsort((-mean, -probability.round(DIGITS)))
    return Proposed(rivals, kinds, outputs, evidence, probability, [int(each) for each in order])
