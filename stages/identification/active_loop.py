"""Algorithm 1: identify, choose the trajectory that tells most, execute it, take its best samples, identify again.

In: `candidates` (no force), `references`, `initial_trials`, `hyperprior`, `scaling`, `hardware_recordings`, `task` (the
inputs that models are wanted for) where a choice asks for it, and the rig.
Out, one part per trial: `trials` (what was chosen and why), `active_recordings` (what was measured), `models` (the MAP
after each trial; trial 0 is the initial data's), `points` (the samples each model stands on) and `decisions` (of an
operator, where one attended). Every arm starts from the same initial data; controls differ from the design in how they
choose trajectories and in nothing else.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import count
from typing import Annotated, Any, ClassVar, Self

import numpy as np
import pandas as pd
from pydantic import Field, PositiveInt, model_validator

from pipeline.config import Section, Target, View
from pipeline.context import Context
from pipeline.errors import ConfigError
from pipeline.stage import stage
from pipeline.table import Table, column
from stages.science.figures.expected_errors import draw_expected_errors
from stages.science.figures.trial_commands import draw_chosen_trials
from stages.science.gp.interaction import Design, Interaction
from stages.science.gp.knowledge import Choice
from stages.science.gp.task_utilities import TASK_UTILITIES, tell_unit
from stages.science.gp.utility_names import name_utility
from stages.science.muscle_models.bent_inputs import Search
from stages.science.muscle_models.description import describe_choice, describe_models
from stages.science.muscle_models.error_rates import ForceTest
from stages.science.muscle_models.expected_errors import Seen, Spread, forecast_error, thin
from stages.science.muscle_models.inputs import ModelSettings, describe_features
from stages.science.muscle_models.loop_settings import DesignSettings, Movements, Utility, refuse_repeats
from stages.science.muscle_models.muscle_set import MuscleSet
from stages.science.muscle_models.samples import keep_usable, spread_evenly, take
from stages.science.plant.exoskeleton import Exoskeleton
from stages.science.rig.attendance import TrialDeclined
from stages.science.rig.contract import MEASUREMENT_COLUMNS, MOST_ROWS, RECORDING_COLUMNS, Rig
from stages.science.rig.limits import speed_samples
from stages.science.rig.reference import describe_sources, exchange_columns, read_sources, track
from stages.science.rig.trial import Proposal
from stages.science.signals.bending import Bending, describe_changes, read_changes
from stages.science.signals.scaling import MODEL_INPUTS, MODEL_OUTPUT, Array

WHERE = {
    "participant": column(str, "who tracked"),
    "experiment": column(int, "experiment of this participant", low=1),
    "arm": column(str, "how trajectories were chosen"),
    "trial": column(int, "trial of this experiment and arm; 0 = initial data alone", low=0),
}
TRIALS = Table(
    "trials",
    "A trial of the interaction design: what was chosen",
    {
        **WHERE,
        "trajectory": column(int, "movement of the bank that was chosen", low=0),
        "utility": column(
            float,
            "its utility: the sum over muscles, over samples as active_loop.reduce says; nats, for variance and "
            "integrated_variance the square of standard units",
            nullable=True,
        ),
        "runner_up": column(float, "utility of the best trajectory that was not chosen", nullable=True),
        "available": column(int, "trajectories that could be chosen", low=1),
        "pressures_from": column(
            str,
            "movements that pressures were taken from, as 'pam1 3, pam2 17'; empty: its own. With "
            "active_loop.exchange_pressures=true",
            optional=True,
        ),
        "bent_by": column(
            str,
            "coefficients of the cubic splines that were added to joints' references (rad) and muscles' pressure "
            "commands (kPa) before these were kept within the bank's bounds; empty: none, as in controls. With "
            "active_loop.bending.coefficients",
            optional=True,
        ),
        "bent_utility": column(
            float,
            "what bending was expected to add to utility, by every so-many-th input of the task",
            nullable=True,
            optional=True,
        ),
        "surprise": column(
            float,
            "error rate of the models' prediction of the trial's forces before they learned from it, mean over muscles",
            low=0,
        ),
        "expected_error": column(
            float,
            "error rate, mean over muscles, to be expected on the task after the trial (median), by trials left out of "
            "the models in turn",
            low=0,
            optional=True,
        ),
        "expected_low": column(float, "lower end of its 95 % interval", low=0, optional=True),
        "expected_high": column(float, "upper end of it", low=0, optional=True),
        "expected_below": column(
            float,
            "probability that it is below active_loop.until.error_percent, where that is set",
            low=0,
            high=1,
            nullable=True,
            optional=True,
        ),
        "expected_next": column(
            float,
            "to be expected after the trial that would be chosen next, where active_loop.until.gain_percent is set; "
            "none after the last trial and where trials are random",
            low=0,
            nullable=True,
            optional=True,
        ),
    },
    key=tuple(WHERE),
)
ACTIVE_RECORDINGS = Table(
    "active_recordings",
    "A sample of a muscle in a designed trial",
    {**WHERE, **RECORDING_COLUMNS},
    key=(*WHERE, "muscle", "time_s"),
)
MODELS = Table(
    "models",
    "One hyperparameter of a muscle's model after a trial, at the maximum of its posterior",
    {
        **WHERE,
        "muscle": column(str, "muscle"),
        "hyperparameter": column(str, "as in hyperprior"),
        "value": column(float, "maximum a posteriori, in the unit that hyperprior names"),
        "sd": column(float, "standard deviation of the Laplace approximation, in the same unit", low=0),
        "log_posterior": column(float, "of the whole vector (nats)"),
        "repair": column(str, "what was done about an indefinite Hessian or a failed factorisation; empty = nothing"),
    },
    key=(*WHERE, "muscle", "hyperparameter"),
)
POINTS = Table(
    "points",
    "A sample that a muscle's model stands on, from the trial in which it was taken (0: any initial trial)",
    {
        **WHERE,
        "muscle": column(str, "muscle"),
        "pick": column(int, "order of picking within the trial", low=0),
        **{name: MEASUREMENT_COLUMNS[name] for name in ("time_s", *MODEL_INPUTS, MODEL_OUTPUT)},
        **describe_features(),
    },
    key=(*WHERE, "muscle", "pick"),
)
DECISIONS = Table(
    "decisions",
    "An operator's decision on a designed trial, where one attended",
    {
        **WHERE,
        "attempt": column(int, "of this trial", low=1),
        "trajectory": column(int, "movement of the bank that was proposed", low=0),
        "decision": column(
            str,
            "keep: executed and learned from; repeat: executed, kept aside, and executed again; reject: executed, kept "
            "aside, and not proposed again; skip: not executed, another one took its place",
            among=["keep", "repeat", "reject", "skip"],
        ),
        "note": column(str, "what the operator wrote; 'by itself' where trials followed by themselves"),
        "stopped": column(str, "why it was stopped before, if it was"),
    },
    key=(*WHERE, "attempt"),
)


Percent = Annotated[float, Field(gt=0, lt=100)]


class Until(Section):
    """When an experiment ends before all its trials are done: of what is not null, whichever comes first."""

    error_percent: Percent | None
    probability: Annotated[float, Field(gt=0, lt=1)]
    gain_percent: Percent | None


class BendingSettings(Section):
    """How chosen movements are bent: coefficients of each joint and muscle, and bent movements that are scored."""

    coefficients: Annotated[int, Field(ge=4, le=100)] | None
    evaluations: Annotated[int, Field(ge=2, le=100_000)]


class ActiveLoop(DesignSettings):
    """Config group ``active_loop``."""

    exchange_pressures: bool
    bending: BendingSettings
    controls: list[Utility] | None
    control_experiments: PositiveInt | None
    until: Until
    expected_error: Spread

    @model_validator(mode="after")
    def _name_controls_once(self) -> Self:
        refuse_repeats(self.controls or [], "active_loop")
        if self.controls == [self.utility]:
            raise ValueError(f"controls: expected other than the design's {self.utility}, got it alone; [] = none")
        names = [name_utility(each) for each in dict.fromkeys([self.utility, *(self.controls or [])])]
        for name in names:
            if names.count(name) > 1:
                raise ValueError(f"arms are called by their functions, of which two are {name}; rename one")
        return self

    def design(self, mean: str, utility: str | None = None) -> Design:
        """Return the choices of the arm of that name."""
        own: dict[str, str] = {name_utility(each): each for each in (self.utility, *(self.controls or []))}
        return super().design(mean, own.get(utility or "", utility))


class Thinning(View):
    """What the loop is given."""

    every: int
    experiments: int
    initial_trials: int


class TaskKnown(View):
    """Choices that serve a task have one."""

    active_loop: ActiveLoop
    workflow: dict[str, Any]

    @model_validator(mode="after")
    def _find_task(self) -> Self:
        section = self.active_loop
        asked = section.utility, section.subsample_utility, *(section.controls or [])
        if "task" in self.workflow["stages"]:
            return self
        if section.until.error_percent is not None or section.until.gain_percent is not None:
            raise ValueError(
                "active_loop.until: expected errors are those on a task, and this workflow has no stage task, which "
                "says what models are wanted for; set active_loop.until.error_percent=null and "
                "active_loop.until.gain_percent=null, or leave experiment and workflow out"
            )
        for name in asked:
            if name in TASK_UTILITIES:
                raise ValueError(
                    f"active_loop.utility: {name} asks for the stage task, which says what models are wanted for, and "
                    "this workflow has none; set active_loop=paper, or leave experiment and workflow out"
                )
        return self


class TrialsFit(View):
    """The bank holds a movement for every trial, trials the samples that models take, and memory all recordings."""

    bank: Movements
    subsampling: Thinning
    active_loop: ActiveLoop
    exoskeleton: Exoskeleton
    participants: dict[str, Any]

    @model_validator(mode="after")
    def _fit(self) -> Self:
        section, initial_trials, samples = self.active_loop, self.subsampling.initial_trials, self.exoskeleton.samples
        check_budget(section, self.bank.trajectories, initial_trials)
        if section.points_per_trial > samples:
            raise ValueError(
                f"active_loop.points_per_trial: expected at most the {samples} samples of a trial, "
                f"got {section.points_per_trial}; lower it or raise exoskeleton.trial_s or "
                "exoskeleton.sampling_rate_hz"
            )
        if section.initial_points > initial_trials * samples:
            raise ValueError(
                f"active_loop.initial_points: expected at most the {initial_trials * samples} samples of the "
                f"{initial_trials} initial trials, got {section.initial_points}; lower it or raise "
                "subsampling.initial_trials, exoskeleton.trial_s or exoskeleton.sampling_rate_hz"
            )
        arms, kept = choose_arms(section, False), -(-samples // self.subsampling.every)
        if "log_det" in arms and section.joint_every >= kept:
            raise ValueError(
                f"active_loop.joint_every: expected less than the {kept} samples that a trajectory keeps "
                f"(subsampling.every={self.subsampling.every}), so that more than one is joined, "
                f"got {section.joint_every}; lower it"
            )
        trials = len(arms) * section.trials * len(self.participants)
        most = MOST_ROWS // (trials * samples * len(self.exoskeleton.muscles))
        if self.subsampling.experiments > most:
            raise ValueError(
                f"subsampling.experiments: expected at most {most} for each participant, as {MOST_ROWS} rows of "
                f"recordings in all arms and trials still fit in memory, got {self.subsampling.experiments}; lower it, "
                "active_loop.trials, exoskeleton.trial_s or exoskeleton.sampling_rate_hz"
            )
        return self


class Config(Section):
    """What this stage reads."""

    checks: ClassVar = (TrialsFit, TaskKnown)

    active_loop: ActiveLoop
    model: ModelSettings
    rig: Target
    seed: int


EXTENT = tuple(f"active_loop.{key}" for key in ("trials", "until", "controls", "control_experiments"))
"""Keys that say how many trials there are, and nothing of what one is."""


@stage(TRIALS, ACTIVE_RECORDINGS, MODELS, POINTS, DECISIONS, stream="active_loop", extent=EXTENT)
def active_loop(
    cfg: Config,
    candidates: pd.DataFrame,
    references: pd.DataFrame,
    initial_trials: pd.DataFrame,
    hyperprior: pd.DataFrame,
    scaling: pd.DataFrame,
    hardware_recordings: pd.DataFrame,
    ctx: Context,
    task: pd.DataFrame | None = None,
) -> dict[str, pd.DataFrame]:
    """Choose, execute and learn from one interaction after another, for every experiment and arm."""
    muscles = MuscleSet.read(candidates, hyperprior, scaling)
    rig: Rig = ctx.device
    arms = choose_arms(cfg.active_loop, rig.real)
    check_budget(cfg.active_loop, len(muscles.trajectories), int(initial_trials["position"].max()))
    section = cfg.active_loop
    if section.exchange_pressures and rig.recorded:
        raise ConfigError(
            f"active_loop.exchange_pressures: expected false, as {type(rig).__name__} returns trials as they were once "
            "recorded, and none has exchanged pressures; leave it out, or choose another rig"
        )
    rig.check_bank(references, "trajectory")
    tasks = [] if task is None else muscles.inputs_of(task)
    bending = None
    if section.bending.coefficients is not None and not rig.recorded:
        joints = dict(zip(rig.muscles, rig.muscle_joints, strict=True))
        bending = Bending.read(references, joints, rig.samples, speed_samples(rig.sampling_rate_hz))
    experiments = initial_trials.groupby(["participant", "experiment"], sort=False)
    loops: dict[str, tuple[Loop]] = {}
    for (participant, experiment), initial in experiments:
        executed = hardware_recordings.query("participant == @participant and experiment == @experiment")
        known = keep_usable(cfg.model.extend(executed, ["position"]))
        start = spread_evenly(known, cfg.active_loop.initial_points, muscles.names)
        used = [int(each) for each in initial["trajectory"]]
        most = cfg.active_loop.control_experiments
        for arm in arms if most is None or int(str(experiment)) <= most else arms[:1]:
            number = len(initial_trials) + len(loops) * cfg.active_loop.trials
            who = str(participant), int(str(experiment))
            loop = Loop(cfg, ctx, muscles, tasks, candidates, references, bending, start, used, *who, arm, number)
            loops["{} experiment {} {}".format(*who, arm)] = (loop,)
    tables = ctx.land("experiments", Loop.run, loops)
    tables[TRIALS.name] = tell_ends(tables[TRIALS.name], cfg.active_loop)
    designed = tables["trials"][tables["trials"]["arm"] == arms[0]]
    first = designed.iloc[0]
    chosen = designed.query("participant == @first.participant and experiment == @first.experiment")
    caption = (
        f"References and pressure commands chosen for {first.participant}, experiment {first.experiment}, "
        f"by {arms[0]}, in the order of the trials."
    )
    if chosen.get("pressures_from", pd.Series("")).any():
        caption += " Pressures are each muscle's own choice of a movement (trials.pressures_from)."
    if chosen.get("bent_by", pd.Series("")).any():
        caption += " They are shown as they were bent within the bank's bounds, to tell more (trials.bent_by)."
    commands = gather_commands(chosen, references, bending)
    figure = draw_chosen_trials(chosen, commands, rig.exoskeleton.muscles_by_joint)
    ctx.figure("selected_interactions", figure, caption)
    if tasks:
        caption = (
            f"Error rate, mean over muscles, to be expected on the task after each trial chosen by {arms[0]}: what the "
            "models expect of themselves, corrected by trials that were left out of them in turn."
        )
        limit = cfg.active_loop.until.error_percent
        ctx.figure("expected_error", draw_expected_errors(designed, None if limit is None else limit / 100.0), caption)
    return tables


def tell_ends(trials: pd.DataFrame, section: ActiveLoop) -> pd.DataFrame:
    """Return trials with what their experiments may end by now, which may have changed since they were executed."""
    until, columns = section.until, dict(trials)
    for name, limit in (("expected_below", until.error_percent), ("expected_next", until.gain_percent)):
        if limit is None:
            columns.pop(name, None)
    if until.error_percent is not None and "expected_error" in columns:
        told = trials[["expected_error", "expected_high", "trial"]].itertuples(index=False)
        limit = until.error_percent / 100.0
        below = [section.expected_error.probability_below(limit, *each) for each in told]
        columns["expected_below"] = pd.Series(below, index=trials.index)
    return TRIALS.select(pd.DataFrame(columns))


def gather_commands(chosen: pd.DataFrame, references: pd.DataFrame, bending: Bending | None) -> pd.DataFrame:
    """Return the references and pressure commands of chosen trials, with a column trial."""
    frames = []
    for row in chosen.to_dict("records"):
        sources = read_sources(row.get("pressures_from", ""))
        rows = exchange_columns(references, int(row["trajectory"]), sources)
        if bending is not None:
            rows = bending.bend(rows, read_changes(row.get("bent_by", "")))
        frames.append(rows.assign(trial=row["trial"]))
    return pd.concat(frames, ignore_index=True)


def check_budget(section: ActiveLoop, movements: int, initial: int) -> None:
    """Refuse a bank without movements to choose from, and more trials than there are."""
    if section.reuse_trajectories:
        return
    if movements <= initial:
        raise ConfigError(
            f"bank.trajectories: expected more than the {initial} initial trials (subsampling.initial_trials), so that "
            f"one is left to choose, got {movements}; raise it by active_loop.trials or set "
            "active_loop.reuse_trajectories=true"
        )
    if section.trials > movements - initial:
        raise ConfigError(
            f"active_loop.trials: expected at most {movements - initial} ({movements} movements of the bank less "
            f"{initial} initial trials), got {section.trials}; "
            "raise bank.trajectories, lower subsampling.initial_trials or set active_loop.reuse_trajectories=true"
        )


def choose_arms(section: ActiveLoop, real: bool) -> list[str]:
    """Return the design's utility, then the controls; a real rig executes only controls that were asked for."""
    controls = section.controls
    if controls is None:
        controls = [] if real else ["y_y", "random"]
    return [name_utility(each) for each in dict.fromkeys([section.utility, *controls])]


Part = dict[str, pd.DataFrame]
Parts = Sequence[Part]
"""What trials left on disk, by table."""


@dataclass(frozen=True)
class Loop:
    """One experiment's trials in one arm, numbered from the first on."""

    cfg: Config
    ctx: Context
    muscles: MuscleSet
    tasks: list[Array]
    candidates: pd.DataFrame
    references: pd.DataFrame
    bending: Bending | None
    start: pd.DataFrame
    initial: list[int]
    participant: str
    experiment: int
    arm: str
    first: int
    seen: dict[int, Seen] = field(default_factory=dict)
    """Of executed trials, what expected errors are told from."""

    def run(self) -> list[str]:
        """Run all trials, each from what the earlier ones left on disk; return the keys of their parts."""
        landed: list[Part] = []
        declined: list[pd.DataFrame] = []
        keys: list[str] = []
        with self.ctx.device as rig:
            for trial in range(1, self.cfg.active_loop.trials + 1):
                landed.append(self.land(trial, landed, declined, keys, rig))
                if self.is_enough(landed[-1]):
                    break
        return keys

    def is_enough(self, part: Part) -> bool:
        """Return whether the error that is to be expected after a trial ends the experiment."""
        until = self.cfg.active_loop.until
        trial = tell_ends(part[TRIALS.name], self.cfg.active_loop).iloc[0]
        if trial.get("expected_below", 0.0) >= until.probability:
            return True
        gain = trial.get("expected_error", np.inf) - trial.get("expected_next", np.nan)
        return bool(100.0 * gain < (until.gain_percent or 0.0))

    def land(self, trial: int, landed: Parts, declined: list[pd.DataFrame], keys: list[str], rig: Rig) -> Part:
        """Return the part of a trial once the operator, if there is one, keeps it; note those that were declined."""
        record = self.ctx.record
        note: Callable[[], Part] = dict
        for attempt in count(1):
            aside = self.key(trial, attempt)
            if not record.holds(aside):
                try:
                    part = record.part(self.key(trial), partial(self.run_trial, trial, attempt, landed, declined, rig))
                    keys.append(record.name(self.key(trial)))
                    return part
                except TrialDeclined as error:
                    note = partial(self.note_declined, trial, attempt, error)
            noted = record.part(aside, note)
            keys.append(record.name(aside))
            declined.append(noted[DECISIONS.name])
        raise AssertionError("attempts are counted without end")

    def key(self, trial: int, declined: int | None = None) -> tuple[object, ...]:
        """Return what names a trial's part, or that of an attempt that the operator declined."""
        aside = () if declined is None else (f"declined{declined}",)
        return self.participant, self.experiment, self.arm, f"{trial:02d}", *aside

    def run_trial(self, trial: int, attempt: int, landed: Parts, declined: Sequence[pd.DataFrame], rig: Rig) -> Part:
        """Choose a trajectory, execute it, learn from it."""
        models, points = [], []
        interaction = self.resume(landed)
        if not landed:
            points.append(self.label(self.start, 0))
            models.append(self.label(describe_models(interaction.models, self.muscles), 0))
        generator = self.ctx.generator("random", self.participant, self.experiment, trial)
        rejected, skipped = list_declined(declined, trial)
        available = [self.muscles.trajectories[index] for index in interaction.available]
        left = [each for each in available if each not in rejected]
        out = {*rejected, *skipped} if set(left) - set(skipped) else set(rejected)  # all skipped: the first again
        choice = interaction.ask(generator, but=self.muscles.indices(sorted(out)))
        described: dict[str, Any] = describe_choice(choice, interaction, self.muscles)
        if self.cfg.active_loop.exchange_pressures:
            described["pressures_from"] = describe_sources(self.name_sources(choice))
        rows = exchange_columns(self.references, described["trajectory"], self.name_sources(choice))
        if self.bending is not None:
            changes, gained = self.bend(rows, choice, interaction, trial, rig)
            rows = self.bending.bend(rows, changes)
            described |= {"bent_by": describe_changes(changes), "bent_utility": gained}
        reason = explain(described, self.arm, aside=bool(out))
        samples = self.execute(rows, choice, described["trajectory"], reason, trial, landed, len(left), rig)
        usable = keep_usable(self.cfg.model.extend(samples, []))
        surprise = float(np.mean(ForceTest.read("trial", usable, self.muscles).error_rates(interaction.models)))
        told, picks = interaction.tell(choice.trajectory, *self.muscles.standardise(usable), self.starts(trial))
        points.append(self.label(take(usable, picks, self.muscles.names), trial))
        models.append(self.label(describe_models(told.models, self.muscles), trial))
        described |= {"surprise": surprise, **self.look_ahead(told, points, usable, landed, trial)}
        part = {
            TRIALS.name: self.label(pd.DataFrame([described]), trial),
            ACTIVE_RECORDINGS.name: self.label(samples, trial),
            MODELS.name: pd.concat(models, ignore_index=True),
            POINTS.name: POINTS.select(pd.concat(points, ignore_index=True)),
        }
        if rig.attendance.attends:
            decision = attempt, described["trajectory"], "keep", rig.attendance.note, ""
            part[DECISIONS.name] = self.describe_decision(trial, *decision)
        return part

    def look_ahead(
        self, told: Interaction, points: Sequence[pd.DataFrame], usable: pd.DataFrame, landed: Parts, trial: int
    ) -> dict[str, float]:
        """Return the columns of a trial that say which error is to be expected on the task, if there is one."""
        if not self.tasks:
            return {}
        section = self.cfg.active_loop
        known = pd.concat([*(part["points"] for part in landed), *points], ignore_index=True)
        self.seen[trial] = thin(usable, self.muscles)
        for number, part in enumerate(landed, 1):
            if number not in self.seen:
                rows = keep_usable(self.cfg.model.extend(part["active_recordings"], []))
                self.seen[number] = thin(rows, self.muscles)
        executed = [self.seen[number] for number in range(1, trial + 1)]
        forecast = forecast_error(told.models, self.tasks, self.muscles, known, executed, section.expected_error)
        low, high = forecast.interval
        columns = {"expected_error": forecast.median, "expected_low": low, "expected_high": high}
        if section.until.gain_percent is not None:
            chosen = self.arm != "random" and trial < section.trials
            following = told.ask(self.ctx.generator("random"), score_all=False) if chosen else None
            columns["expected_next"] = np.nan if following is None else forecast.after(told.foresee(following))
        return columns

    def note_declined(self, trial: int, attempt: int, declined: TrialDeclined) -> Part:
        """Return the part of a trial that the operator declined: the decision, and nothing to learn from."""
        assert declined.trial.proposal is not None
        told = declined.trial.proposal.trajectory, declined.decision, declined.note, declined.stopped
        return {DECISIONS.name: self.describe_decision(trial, attempt, *told)}

    def describe_decision(self, trial: int, *told: object) -> pd.DataFrame:
        """Return a decision's row: attempt, trajectory, decision, the operator's note, and why it was stopped."""
        return self.label(pd.DataFrame([told], columns=list(DECISIONS.columns)[len(WHERE) :]), trial)

    def resume(self, landed: Parts) -> Interaction:
        """Return the state by what the trials so far left on disk, or by the initial points, and by nothing else."""
        muscles, section = self.muscles, self.cfg.active_loop
        design = section.design(self.muscles.mean, self.arm)
        if section.exchange_pressures:
            design = replace(design, exchanged=self.cfg.model.pressure_inputs)
        used = [*self.initial, *(int(part["trials"]["trajectory"].iloc[0]) for part in landed)]
        if landed:
            points = pd.concat([part["points"] for part in landed], ignore_index=True)
            return muscles.resume(design, used, points, landed[-1]["models"], self.tasks)
        known = muscles.candidates, muscles.priors, *muscles.standardise(self.start), muscles.indices(used)
        return Interaction.begin(design, *known, self.starts(0), self.tasks)

    def starts(self, trial: int) -> list[np.random.Generator]:
        """Return a generator for each muscle's MAP search; arms share them."""
        return [
            self.ctx.generator("starts", self.participant, self.experiment, trial, name) for name in self.muscles.names
        ]

    def bend(
        self, rows: pd.DataFrame, choice: Choice, interaction: Interaction, trial: int, rig: Rig
    ) -> tuple[dict[str, Array], float]:
        """Return how a movement of the design is bent, and the utility that this adds; random ones are not."""
        section = self.cfg.active_loop.bending
        assert self.bending is not None
        assert section.coefficients is not None
        if choice.scores is None or self.arm != name_utility(self.cfg.active_loop.utility):
            return {}, np.nan
        per_rad = {each.name: each.contraction_per_rad for each in rig.exoskeleton.muscles}
        known = self.muscles, self.cfg.model, interaction.weigh
        search = Search(self.bending, per_rad, *known)
        generator = self.ctx.generator("bending", self.participant, self.experiment, trial)
        pressures = [each.column for each in self.cfg.model.features if each.of_pressure]
        trajectory = self.muscles.trajectories[choice.trajectory]
        recorded = exchange_columns(self.candidates, trajectory, self.name_sources(choice), pressures)
        return search.run(rows, recorded, section.coefficients, section.evaluations, generator)

    def execute(
        self,
        rows: pd.DataFrame,
        choice: Choice,
        trajectory: int,
        reason: str,
        trial: int,
        landed: Parts,
        left: int,
        rig: Rig,
    ) -> pd.DataFrame:
        """Execute the rows of a chosen trajectory; arms share the person's and the sensors' noise at equal trials."""
        label = f"{self.participant} experiment {self.experiment} {self.arm} trial {trial}"
        generator = self.ctx.generator("rig", self.participant, self.experiment, trial)
        section, needed = self.cfg.active_loop, self.cfg.active_loop.trials - trial + 1
        scores = {} if choice.scores is None else dict(zip(self.muscles.trajectories, choice.scores, strict=True))
        proposal = Proposal(
            position=trial,
            total=section.trials,
            reason="; ".join([reason, *(describe_expected(landed[-1]) if landed else [])]),
            trajectory=trajectory,
            utilities={each: float(score) for each, score in scores.items() if np.isfinite(score)},
            utility_unit=tell_unit(self.arm),
            errors=tuple(float(part[TRIALS.name]["surprise"].iloc[0]) for part in landed),
            can_skip=left > 1,
            can_reject=left > (1 if section.reuse_trajectories else needed),
        )
        watch = self.ctx.record.watch(self.key(trial))
        number = self.first + trial - 1
        return track(rows, rig, self.participant, label, generator, watch, number, proposal)

    def name_sources(self, choice: Choice) -> dict[str, int]:
        """Return the movements that pressures are taken from, by muscle; none where they are not exchanged."""
        names = self.muscles.names if choice.sources else []
        return {name: self.muscles.trajectories[source] for name, source in zip(names, choice.sources, strict=True)}

    def label(self, frame: pd.DataFrame, trial: int) -> pd.DataFrame:
        """Put participant, experiment, arm and trial before a frame's columns."""
        where: dict[str, Any] = {"participant": self.participant, "experiment": self.experiment, "arm": self.arm}
        return frame.assign(**where, trial=trial)[[*WHERE, *(name for name in frame if name not in WHERE)]]


def list_declined(declined: Sequence[pd.DataFrame], trial: int) -> tuple[list[int], list[int]]:
    """Return the movements that were rejected so far, and those that were skipped in a trial."""
    if not declined:
        return [], []
    rows = pd.concat(declined, ignore_index=True)
    rejected = rows.loc[rows["decision"] == "reject", "trajectory"]
    skipped = rows.loc[(rows["decision"] == "skip") & (rows["trial"] == trial), "trajectory"]
    return sorted(set(rejected.astype(int))), sorted(set(skipped.astype(int)))


def describe_expected(part: Part) -> list[str]:
    """Say which error is to be expected on the task after a trial, where there is one."""
    trial = part[TRIALS.name].iloc[0]
    if "expected_error" not in trial:
        return []
    told, low, high = (100.0 * trial[name] for name in ("expected_error", "expected_low", "expected_high"))
    return [f"{told:.2g} % of error to be expected on the task (95 %: {low:.2g} to {high:.2g})"]


def explain(described: dict[str, Any], arm: str, aside: bool) -> str:
    """Say why a movement was chosen; `aside` says whether skipped or rejected ones could not be."""
    movement = f"movement {described['trajectory']} of the bank"
    if described.get("pressures_from"):
        movement += f" with pressures of other movements ({described['pressures_from']})"
    if described.get("bent_by"):
        movement += f", bent (utility + {described['bent_utility']:.3g})"
    if np.isnan(described["utility"]):
        return f"{movement}, drawn at random"
    among = "not skipped or rejected"
    most = f"tells most of those {among}" if aside else "tells most"
    told = f"{movement} {most}: utility {arm} {described['utility']:.4g}"
    if np.isnan(described["runner_up"]):
        return f"{told}; no other is left{f' that was {among}' if aside else ''}"
    return f"{told}, the next best's {described['runner_up']:.4g}"
