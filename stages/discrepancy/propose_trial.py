"""Which trial to record next: the one that would tell the leading names apart.

In: what was measured, the nominal fit, what was named and the rounds of the search. Out: `proposed_trials`, each kind
of excitation with the evidence that it promises, the best first; `proposed_signals`, what drives the machine in the
best, and what each rival predicts there; and `proposal`, the same in words. Nothing is recorded.
"""

from collections.abc import Mapping

import numpy as np
import pandas as pd

from pipeline.config import Section
from pipeline.context import Context
from pipeline.stage import stage
from pipeline.table import Table, column
from stages.science.discrepancy.dataset import DatasetTables, build_dataset
from stages.science.discrepancy.proposal import ProposalSettings, Proposed, choose_round, predict, propose
from stages.science.discrepancy.report_text import describe_proposal
from stages.science.discrepancy.restoring import NominalTables, SearchTables, restore_states
from stages.science.discrepancy.settings import DiscrepancySettings
from stages.science.figures.proposed_trial import draw_proposed_trial
from stages.science.plant.machine import Machine
from stages.science.signals.lead_in import measure_lead_in

PROPOSED_TRIALS = Table(
    "proposed_trials",
    "A kind of excitation that a further trial may have",
    {
        "rank": column(int, "by the probability after it, then by the evidence", low=1),
        "excitation": column(str, "what each lever does, by semicolon"),
        "evidence": column(float, "expected log score of the true name over the next, mean over rivals", unit="nats"),
        "probability": column(float, "expected of the true name after it, among the rivals", low=0, high=1),
    },
    key=("rank",),
)
PROPOSED_SIGNALS = Table(
    "proposed_signals",
    "A sample of the best further trial, as it is prescribed or as a rival predicts it",
    {
        "muscle": column(str, "muscle, or name of the machine"),
        "channel": column(str, "channel that is predicted"),
        "time_s": column(float, "time from the trial's start", unit="s", low=0),
        "signal": column(str, "what drives it, or the name of the rival that predicts the channel"),
        "value": column(float, "in the unit of the signal or of the channel", unit="as named"),
    },
    key=("channel", "muscle", "signal", "time_s"),
)
PROPOSAL = Table("proposal", "What to record next", {"proposal": column(str, "a sentence")}, role="advice")


class Config(Section):
    """What this stage reads."""

    discrepancy: DiscrepancySettings
    propose_trial: ProposalSettings
    plant: Machine


@stage(PROPOSED_TRIALS, PROPOSED_SIGNALS, PROPOSAL)
def propose_trial(
    cfg: Config,
    tables: DatasetTables,
    found: SearchTables,
    nominal_fit: pd.DataFrame,
    residuals: pd.DataFrame,
    ranking: pd.DataFrame,
    ctx: Context,
    hardware_recordings: pd.DataFrame | None = None,
) -> dict[str, pd.DataFrame]:
    """Weigh kinds of excitation by how well they would tell the leading names apart."""
    dataset = build_dataset(cfg.plant, tables, tables.trial_parts, cfg.discrepancy)
    given, written, weighed = cfg.propose_trial, {}, None
    question = choose_round(
        ranking, found.named_effects, found.suspected_effects, given.rivals, given.least_probability
    )
    chosen: Mapping[str, float] = {} if question is None else question.rivals
    if question is not None and dataset.outputs[0].levers:
        nominal = restore_states(dataset, NominalTables(nominal_fit, found.channels, residuals))
        states = [found.resume(state, question.standing) for state in nominal]
        lead_in_s = 0.0 if hardware_recordings is None else measure_lead_in(hardware_recordings)
        weighed = propose(states, chosen, cfg.discrepancy.search.largest_jitter, lead_in_s)
    if weighed is not None:
        written[PROPOSED_TRIALS.name] = list_trials(weighed)
    if weighed is not None and weighed.gain >= given.least_gain:
        written[PROPOSED_SIGNALS.name] = list_signals(weighed)
        ctx.figure(
            "proposed_trial",
            draw_proposed_trial(written[PROPOSED_SIGNALS.name], list(chosen)),
            f"The proposed trial ({weighed.spell(weighed.order[0])}) where rivals differ most: what drives the "
            "machine, what the first of them predicts, and by how much the others' predictions differ from it.",
        )
    sentence = describe_proposal(chosen, weighed, given.least_gain)
    written[PROPOSAL.name] = pd.DataFrame({"proposal": [sentence]})
    return {
        each.name: written.get(each.name, pd.DataFrame(columns=list(each.columns))) for each in propose_trial.writes
    }


def list_trials(weighed: Proposed) -> pd.DataFrame:
    """Return the rows of `proposed_trials`."""
    places = list(weighed.order)
    return pd.DataFrame(
        {
            "rank": range(1, len(places) + 1),
            "excitation": [weighed.spell(each) for each in places],
            "evidence": weighed.mean_evidence[places],
            "probability": weighed.probability[places],
        }
    )


def list_signals(weighed: Proposed) -> pd.DataFrame:
    """Return the rows of `proposed_signals`, of the output in which rivals differ most."""
    place = weighed.clearest
    output = weighed.outputs[place].take([weighed.order[0]])
    told = output.tell_levers() | {each.name: predict(each, place, output)[0] for each in weighed.rivals}
    wide = pd.DataFrame({name: values[:, 0] for name, values in told.items()})
    wide = wide.assign(muscle=output.element, channel=output.channel, time_s=output.step_s * np.arange(len(wide)))
    return wide.melt(["muscle", "channel", "time_s"], var_name="signal")
