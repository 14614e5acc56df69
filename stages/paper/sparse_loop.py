"""Algorithm 1 with models that keep all samples: the paper's future work.

In: `candidates` (no force), `references`, `initial_trials`, `hyperprior`, `scaling`, `hardware_recordings` and the rig.
Out, one part per trial: `sparse_trials` (what was chosen), `sparse_recordings` (what was measured), `sparse_models`
(the hyperparameters after each trial; trial 0 is the initial data's) and `sparse_pseudo_inputs` (where each model's
pseudo-inputs lie and how they weigh). Beside them `documents/cost.json`: what one trial's identification and scores
take, sparse and exact. Experiments begin with the same initial trials as those of `active_loop`, of which all samples
are kept, thinned; a control on the same models chooses at random, so that the gain of choosing is parted from that of
keeping.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
import pandas as pd
from pydantic import Field, NonNegativeInt, PositiveInt, model_validator

from pipeline.config import Section, Target, View
from pipeline.context import Context
from pipeline.errors import ConfigError
from pipeline.stage import stage
from pipeline.table import Table, column
from stages.science.gp.marginal import fit
from stages.science.gp.marginal_model import MarginalModel
from stages.science.gp.scoring import trajectory_utility
from stages.science.gp.sparse_interaction import SparseDesign, SparseInteraction
from stages.science.muscle_models.cost import measure_cost
from stages.science.muscle_models.description import describe_choice, describe_models
from stages.science.muscle_models.inputs import MeasuredInputs
from stages.science.muscle_models.loop_settings import Movements, refuse_repeats
from stages.science.muscle_models.muscle_set import MuscleSet
from stages.science.muscle_models.samples import thin
from stages.science.plant.exoskeleton import Exoskeleton
from stages.science.rig.attendance import until_kept
from stages.science.rig.contract import MOST_ROWS, RECORDING_COLUMNS, Rig
from stages.science.rig.reference import track
from stages.science.rig.trial import Proposal
from stages.science.signals.scaling import MODEL_INPUTS

MOST_NUMBERS = 25_000_000
"""Pseudo-inputs x samples of a muscle, beyond which the working memory of all muscles (16 bytes each) passes 1.6 GB."""

WHERE = {
    "participant": column(str, "who tracked"),
    "experiment": column(int, "experiment of this participant, as in active_loop", low=1),
    "arm": column(str, "how trajectories were chosen"),
    "trial": column(int, "trial of this experiment and arm; 0 = initial data alone", low=0),
}
SPARSE_TRIALS = Table(
    "sparse_trials",
    "A trial with sparse models: what was chosen",
    {
        **WHERE,
        "trajectory": column(int, "movement of the bank that was chosen", low=0),
        "utility": column(float, "its utility: the sum over muscles, as in trials", nullable=True),
        "runner_up": column(float, "utility of the best trajectory that was not chosen", nullable=True),
        "available": column(int, "trajectories that could be chosen", low=1),
        "samples": column(int, "samples that each muscle's model stands on after the trial", low=1),
    },
    key=tuple(WHERE),
)
SPARSE_RECORDINGS = Table(
    "sparse_recordings",
    "A sample of a muscle in a trial with sparse models",
    {**WHERE, **RECORDING_COLUMNS},
    key=(*WHERE, "muscle", "time_s"),
)
SPARSE_MODELS = Table(
    "sparse_models",
    "One hyperparameter of a muscle's sparse model after a trial, at the maximum that was found",
    {
        **WHERE,
        "muscle": column(str, "muscle"),
        "hyperparameter": column(str, "as in hyperprior"),
        "value": column(float, "maximum a posteriori, in the unit that hyperprior names"),
        "sd": column(float, "SD of the Laplace approximation with pseudo-inputs held, in the same unit", low=0),
        "log_posterior": column(float, "of hyperparameters and pseudo-inputs (nats)"),
        "repair": column(str, "what was done about an indefinite Hessian or a failed factorisation; empty = nothing"),
    },
    key=(*WHERE, "muscle", "hyperparameter"),
)
SPARSE_PSEUDO_INPUTS = Table(
    "sparse_pseudo_inputs",
    "A pseudo-input of a muscle's sparse model after a trial",
    {
        **WHERE,
        "muscle": column(str, "muscle"),
        "pseudo_input": column(int, "its number", low=0),
        "pressure_kpa": column(float, "gauge pressure, not bound to the machine's range", unit="kPa"),
        "contraction": column(float, "contraction, likewise"),
        "contraction_velocity_per_s": column(float, "contraction velocity, likewise", unit="1/s"),
        "weight": column(float, "by which the covariance with it counts in the mean, standard units of force"),
    },
    key=(*WHERE, "muscle", "pseudo_input"),
)
TABLES = (SPARSE_TRIALS, SPARSE_RECORDINGS, SPARSE_MODELS, SPARSE_PSEUDO_INPUTS)

Chosen = Literal["y_y", "f_f", "f_y", "y_y_theta", "hyperparameter_information", "variance", "random"]


class SparseLoop(Section):
    """Config group ``sparse_loop``."""

    utility: Chosen
    controls: list[Chosen]
    experiments: PositiveInt
    trials: Annotated[int, Field(ge=1, le=2000)]
    every: PositiveInt
    pseudo_inputs: Annotated[int, Field(ge=1, le=1000)]
    starts: Annotated[int, Field(ge=1, le=1000)]
    first_iterations: NonNegativeInt
    iterations: NonNegativeInt
    reduce: Literal["sum", "max"]
    reuse_trajectories: bool
    memory_mb: Annotated[float, Field(gt=0, le=2**20)]
    exact_starts: Annotated[int, Field(ge=0, le=1000)]
    real: bool

    @model_validator(mode="after")
    def _name_controls_once(self) -> Self:
        refuse_repeats(self.controls, "sparse_loop")
        return self


class Initial(View):
    """The initial trials of the experiments."""

    experiments: int
    initial_trials: int


class SamplesEnough(View):
    """The bank holds a movement for every trial, trials hold the samples, and everything fits in memory."""

    bank: Movements
    model: MeasuredInputs
    subsampling: Initial
    sparse_loop: SparseLoop
    exoskeleton: Exoskeleton
    participants: dict[str, Any]

    @model_validator(mode="after")
    def _fit(self) -> Self:
        section, initial, samples = self.sparse_loop, self.subsampling.initial_trials, self.exoskeleton.samples
        check_movements(section, self.bank.trajectories, initial)
        kept_of_one = -(-samples // section.every)
        kept = initial * kept_of_one
        if section.pseudo_inputs > kept:
            raise ValueError(
                f"sparse_loop.pseudo_inputs: expected at most the {kept} samples that are kept of the {initial} "
                f"initial trials, got {section.pseudo_inputs}; lower it or sparse_loop.every"
            )
        experiments = len(self.participants) * min(section.experiments, self.subsampling.experiments)
        rows = len(choose_arms(section, False)) * section.trials * samples * len(self.exoskeleton.muscles)
        if rows * experiments > MOST_ROWS:
            raise ValueError(
                f"sparse_loop.experiments: expected recordings of at most {MOST_ROWS} rows in all, which still fit in "
                f"memory, got {rows * experiments}; lower it, sparse_loop.trials or exoskeleton.sampling_rate_hz"
            )
        kept = (initial + section.trials) * kept_of_one
        if kept * section.pseudo_inputs > MOST_NUMBERS:
            raise ValueError(
                f"sparse_loop.every: expected at most {MOST_NUMBERS} pseudo-inputs x samples, which still fit in "
                f"memory, got {section.pseudo_inputs} x {kept}; raise it or lower sparse_loop.pseudo_inputs"
            )
        return self


class Config(Section):
    """What this stage reads."""

    checks: ClassVar = (SamplesEnough,)

    sparse_loop: SparseLoop
    rig: Target
    seed: int


@stage(*TABLES, stream="sparse_loop")
def sparse_loop(
    cfg: Config,
    candidates: pd.DataFrame,
    references: pd.DataFrame,
    initial_trials: pd.DataFrame,
    hyperprior: pd.DataFrame,
    scaling: pd.DataFrame,
    hardware_recordings: pd.DataFrame,
    ctx: Context,
) -> dict[str, pd.DataFrame]:
    """Choose, execute and learn from every sample, for every experiment and arm."""
    section = cfg.sparse_loop
    rig: Rig = ctx.device
    arms = choose_arms(section, rig.real)
    if not arms:
        return {table.name: pd.DataFrame(columns=list(table.columns)) for table in TABLES}
    muscles = MuscleSet.read(candidates, hyperprior, scaling)
    check_movements(section, len(muscles.trajectories), int(initial_trials["position"].max()))
    rig.check_bank(references, "trajectory")
    experiments: dict[str, tuple[Experiment]] = {}
    for (participant, number), initial in initial_trials.groupby(["participant", "experiment"], sort=False):
        if int(str(number)) > section.experiments:
            continue
        executed = hardware_recordings.query("participant == @participant and experiment == @number")
        start = thin(executed, section.every, ["position"])
        used = [int(each) for each in initial["trajectory"]]
        who = str(participant), int(str(number))
        job = Experiment(cfg, ctx, muscles, references, start, used, *who, arms)
        experiments["{} experiment {}".format(*who)] = (job,)
    tables = ctx.land("experiments", Experiment.run, experiments)
    (first,) = next(iter(experiments.values()))
    ctx.document("cost", first.measure_costs(tables))
    return tables


def choose_arms(section: SparseLoop, real: bool) -> list[str]:
    """Return the design's utility, then the controls; none on a real rig unless that was asked for."""
    if real and not section.real:
        return []
    return [section.utility, *(each for each in section.controls if each != section.utility)]


def check_movements(section: SparseLoop, movements: int, initial: int) -> None:
    """Refuse more trials than the bank has movements."""
    if not section.reuse_trajectories and section.trials > movements - initial:
        raise ConfigError(
            f"sparse_loop.trials: expected at most {max(movements - initial, 0)} ({movements} movements of the bank "
            f"less {initial} initial trials), got {section.trials}; lower it, raise bank.trajectories or set "
            "sparse_loop.reuse_trajectories=true"
        )


@dataclass(frozen=True)
class Experiment:
    """One experiment's trials in every arm."""

    cfg: Config
    ctx: Context
    muscles: MuscleSet
    references: pd.DataFrame
    start: pd.DataFrame
    initial: list[int]
    participant: str
    number: int
    arms: list[str]

    def run(self) -> list[str]:
        """Run all trials, each from what the earlier ones left on disk; return the keys of their parts."""
        keys = []
        with self.ctx.device as rig:
            for arm in self.arms:
                landed: list[dict[str, pd.DataFrame]] = []
                for trial in range(1, self.cfg.sparse_loop.trials + 1):
                    key = self.key(arm, trial)
                    make = partial(self.run_trial, arm, trial, landed, rig)
                    landed.append(until_kept(partial(self.ctx.record.part, key, make)))
                    keys.append(self.ctx.record.name(key))
        return keys

    def key(self, arm: str, trial: int) -> tuple[object, ...]:
        """Return what names a trial's part."""
        return self.participant, self.number, arm, f"{trial:02d}"

    def run_trial(
        self, arm: str, trial: int, landed: Sequence[Mapping[str, pd.DataFrame]], rig: Rig
    ) -> dict[str, pd.DataFrame]:
        """Choose a trajectory, execute it, learn from all that was measured."""
        models, pseudo = [], []
        known = self.resume(arm, landed)
        if not landed:
            models.append(self.label(describe_models(known.models, self.muscles), arm, 0))
            pseudo.append(self.label(self.describe_pseudo(known), arm, 0))
        choice = known.ask(self.ctx.generator("random", self.participant, self.number, trial))
        recorded = self.execute(choice.trajectory, arm, trial, rig)
        kept = thin(recorded, self.cfg.sparse_loop.every, [])
        told = known.tell(choice.trajectory, *self.muscles.standardise(kept), self.starts(trial))
        models.append(self.label(describe_models(told.models, self.muscles), arm, trial))
        pseudo.append(self.label(self.describe_pseudo(told), arm, trial))
        chosen = {**describe_choice(choice, known, self.muscles), "samples": len(told.outputs[0])}
        return {
            SPARSE_TRIALS.name: self.label(pd.DataFrame([chosen]), arm, trial),
            SPARSE_RECORDINGS.name: self.label(recorded, arm, trial),
            SPARSE_MODELS.name: pd.concat(models, ignore_index=True),
            SPARSE_PSEUDO_INPUTS.name: pd.concat(pseudo, ignore_index=True),
        }

    @cached_property
    def first(self) -> SparseInteraction:
        """What is known of the initial trials, the same in every arm."""
        muscles = self.muscles
        known = (muscles.candidates, muscles.priors, *muscles.standardise(self.start), muscles.indices(self.initial))
        return SparseInteraction.begin(self.design(self.arms[0]), *known, self.starts(0))

    def resume(self, arm: str, landed: Sequence[Mapping[str, pd.DataFrame]]) -> SparseInteraction:
        """Return an arm's state by what the trials so far left on disk, or by the initial ones, and by nothing else."""
        if not landed:
            return replace(self.first, design=self.design(arm))
        recorded, chosen = (
            pd.concat([part[table.name] for part in landed]) for table in (SPARSE_RECORDINGS, SPARSE_TRIALS)
        )
        kept = thin(recorded, self.cfg.sparse_loop.every, ["trial"])
        used = [*self.initial, *(int(each) for each in chosen["trajectory"])]
        known = self.muscles.recall(used, pd.concat([self.start, kept]), landed[-1][SPARSE_MODELS.name])
        pseudo = self.muscles.inputs_of(self.keep_latest(landed[-1][SPARSE_PSEUDO_INPUTS.name]))
        return SparseInteraction(self.design(arm), *known, pseudo=tuple(pseudo))

    @staticmethod
    def keep_latest(frame: pd.DataFrame) -> pd.DataFrame:
        """Return the rows of the last trial."""
        return frame[frame["trial"] == frame["trial"].max()]

    def design(self, arm: str) -> SparseDesign:
        """Return the arm's way of choosing."""
        own = {"reduce", "reuse_trajectories", "memory_mb", "pseudo_inputs", "starts", "first_iterations", "iterations"}
        return SparseDesign(utility=arm, mean=self.muscles.mean, **self.cfg.sparse_loop.model_dump(include=own))

    def starts(self, trial: int) -> list[np.random.Generator]:
        """Return a generator for each muscle's search; arms share them."""
        return [self.ctx.generator("starts", self.participant, self.number, trial, name) for name in self.muscles.names]

    def execute(self, index: int, arm: str, trial: int, rig: Rig) -> pd.DataFrame:
        """Execute a trajectory of the bank; arms share the person's and the sensors' noise at equal trial number."""
        label = f"{self.participant} experiment {self.number} sparse {arm} trial {trial}"
        generator = self.ctx.generator("rig", self.participant, self.number, trial)
        trajectory, watch = self.muscles.trajectories[index], self.ctx.record.watch(self.key(arm, trial))
        proposal = Proposal(trial, self.cfg.sparse_loop.trials, f"chosen for the sparse models by {arm}", trajectory)
        rows = self.references[self.references["trajectory"] == trajectory]
        return track(rows, rig, self.participant, label, generator, watch, proposal=proposal)

    def label(self, frame: pd.DataFrame, arm: str, trial: int) -> pd.DataFrame:
        """Put participant, experiment, arm and trial before a frame's columns."""
        where: dict[str, Any] = {"participant": self.participant, "experiment": self.number, "arm": arm, "trial": trial}
        return frame.assign(**where)[[*WHERE, *(name for name in frame if name not in WHERE)]]

    def describe_pseudo(self, known: SparseInteraction) -> pd.DataFrame:
        """Return where each model's pseudo-inputs lie and how they weigh."""
        frames = []
        for name, scaling, model in zip(self.muscles.names, self.muscles.scalings, known.models, strict=True):
            frame = pd.DataFrame(scaling.restore_inputs(model.pseudo), columns=list(MODEL_INPUTS))
            numbered = frame.assign(muscle=name, pseudo_input=np.arange(len(frame)), weight=model.sparse.weights)
            frames.append(numbered[["muscle", "pseudo_input", *MODEL_INPUTS, "weight"]])
        return pd.concat(frames, ignore_index=True)

    def measure_costs(self, tables: Mapping[str, pd.DataFrame]) -> dict[str, dict[str, float]]:
        """Measure what identification and scores take after the first arm's last trial, sparse and exact.

        The exact models have as many points as the sparse ones have pseudo-inputs, evenly spread over the same samples.
        """
        section, arm = self.cfg.sparse_loop, self.arms[0]
        own = f"participant == {self.participant!r} and experiment == {self.number} and arm == {arm!r}"
        its = {name: rows.query(own) for name, rows in tables.items()}
        earlier = {name: rows[rows["trial"] < section.trials] for name, rows in its.items()}
        known = self.resume(arm, [earlier] if section.trials > 1 else [])
        kept = thin(self.keep_latest(its[SPARSE_RECORDINGS.name]), section.every, [])
        trajectory = self.muscles.indices(self.keep_latest(its[SPARSE_TRIALS.name])["trajectory"].tolist())[0]
        recorded = self.muscles.standardise(kept)
        inputs = [np.concatenate(each) for each in zip(known.inputs, recorded[0], strict=True)]
        outputs = [np.concatenate(each) for each in zip(known.outputs, recorded[1], strict=True)]
        at = np.linspace(0, len(outputs[0]) - 1, section.pseudo_inputs).astype(int)
        utility = "y_y" if arm == "random" else arm

        def score(models: Sequence[MarginalModel]) -> object:
            return trajectory_utility(models, known.candidates, utility, section.reduce, section.memory_mb)

        def iterate() -> object:
            return score(known.tell(trajectory, *recorded, self.starts(section.trials)).models)

        def iterate_exactly() -> object:
            generators, starts = self.starts(section.trials), section.exact_starts
            data = zip(inputs, outputs, known.priors, generators, strict=True)
            fitted = [fit(x[at], y[at], p, known.design.mean, generator=g, starts=starts) for x, y, p, g in data]
            return score(fitted)

        return {
            "sparse": {"samples": float(len(outputs[0])), **measure_cost(iterate)},
            "exact": {"samples": float(at.size), **measure_cost(iterate_exactly)},
        }
