"""A rig without a machine: what it tells an operator session, in a thread, at a hundred samples a second."""

import contextlib
import re
import shlex
import threading
import time

import numpy as np
import pandas as pd

from stages.science.operator_ui.operator_session import OperatorSession, OperatorSettings, Refused
from stages.science.operator_ui.pages.server import PageServer
from stages.science.rig import clock
from stages.science.rig.attendance import Moment, StudyPaused, TrialDeclined
from stages.science.rig.trial import Proposal, Recording, Trial
from tests.conftest import Command
from tests.science.plant.machines import other_machine

RATE_HZ = 100.0
NOBODY_NEEDED = {"countdown_s": 0.3, "result_s": 0.5, "lost_after_s": 1.0, "needed": []}

STUDY = shlex.split("""
budget=tiny bank.trajectories=8 subsampling.initial_trials=1 active_loop.trials=5 active_loop.controls=[]
exoskeleton.trial_s=0.8 rig.lead_in_s=0.2 rig.realtime=true
task=bank stages=[bank,subsampling,hyperprior,task,hardware,active_loop,tracking_delay,comparison]
operator_ui=pages operator_ui.port=0 operator_ui.countdown_s=0.1 operator_ui.lost_after_s=5.0 operator_ui.result_s=0.0
""")


def make_session(joints=2, trial_s=1.0, **settings):
    """An operator session that shows a machine of that many joints with two muscles each."""
    session = OperatorSession(OperatorSettings(**NOBODY_NEEDED | settings))
    session.machine = other_machine([2] * joints, RATE_HZ, trial_s)
    session.describe(session.machine, pointed=False)
    return session


def open_pages(host="127.0.0.1", **settings):
    """An operator session with these settings, and the server that shows its pages."""
    session = make_session(**settings)
    server = PageServer(session, host, 0)
    server.open()
    return session, server


def make_trial(machine, kind="tracked", position=1, label=""):
    """A calm movement of all joints, proposed among forty others."""
    time_s = np.arange(machine.samples) / RATE_HZ
    phase = 2 * np.pi * time_s / machine.trial_s
    reference = np.stack([0.65 - 0.45 * np.cos(phase + 0.7 * j) for j in range(len(machine.joints))], axis=1)
    command = np.stack([150 + 90 * np.sign(np.sin(2 * phase + m)) for m in range(len(machine.muscles))], axis=1)
    proposal = Proposal(
        position=position,
        total=12,
        reason="movement 17 of the bank tells most: its predictions differ by 21 % between the models",
        trajectory=np.int64(17),
        utility_unit="nat",
        utilities={k: 0.9 if k == 17 else 0.45 + 0.4 * np.sin(k) for k in range(40)},
        errors=tuple(0.4 * 0.9**k for k in range(position - 1)),
        can_skip=True,
        can_reject=True,
    )
    who, shown = "nobody" if kind == "passive" else "p1", reference if kind == "tracked" else None
    return Trial(kind, who, command, shown, label or f"trial {position}", 0, proposal)


def take(trial, machine, time_s):
    """The sample that such a machine gives."""
    row = int(np.clip(round(time_s * RATE_HZ), 0, machine.samples - 1))
    command, lag = trial.pressure_command_kpa[[row, max(row - 8, 0)]]
    reference = 0.4 + 0 * command[::2] if trial.reference_rad is None else trial.reference_rad[max(row - 12, 0)]
    wave = np.sin(7 * time_s + np.arange(len(command)))
    return Moment(time_s, reference + 0.04 * np.sin(5 * time_s), command, lag + 4 * wave, 0.8 * lag + 25 * wave)


class Study(threading.Thread):
    """Executes trials one after the other, and keeps of each its recording, or the exception that said why not."""

    def __init__(self, session, *trials, fill_s=0.1):
        super().__init__(daemon=True)
        self.session, self.trials, self.fill_s = session, trials, fill_s
        self.ended, self.stopped_s = [], None

    def run(self):
        for trial in self.trials:
            try:
                self.ended.append(self.execute(trial))
            except (TrialDeclined, StudyPaused) as error:
                self.ended.append(error)
                if isinstance(error, StudyPaused):
                    return

    def leave(self):
        """Stop, and pause at the next question."""
        self.session.stop("the test is over")
        while self.is_alive():
            scene = self.session.see()
            with contextlib.suppress(Refused):
                self.session.decide(scene["choices"][-1] if scene["choices"] else "", "", scene["question"])
            clock.sleep(0.01)

    def execute(self, trial):
        session, samples = self.session, self.session.machine.samples
        session.propose(trial)
        starts_at_s = clock.now_s() + self.fill_s
        session.begin(trial, starts_at_s)
        moments = []
        for index in range(-round(self.fill_s * RATE_HZ), samples):
            clock.sleep(starts_at_s + index / RATE_HZ - clock.now_s())
            if why := session.why_stop():
                self.stopped_s = clock.now_s()
                session.judge(trial, None, f"stopped: {why}")
                raise AssertionError("a stopped trial was kept")
            moments.append(take(trial, session.machine, index / RATE_HZ))
            session.show(moments[-1])
        time_s, angle, command, pressure, force = map(np.array, zip(*moments[-samples:], strict=True))
        recording = Recording(time_s, command, pressure, 0 * pressure, 0 * pressure, force, angle, 0 * angle)
        session.judge(trial, recording, "")
        return session.add_display(recording)


@contextlib.contextmanager
def serve(outputs, **how):
    """Start the study; the command, its process and the addresses that it tells. It ends with the test."""
    command, addresses = Command(outputs, *STUDY), {}
    with command.start(**how) as process:
        watchdog = threading.Timer(300.0, process.kill)
        watchdog.start()
        try:
            while len(addresses) < 2:
                line = process.stdout.readline()
                assert line, process.stderr.read()
                addresses |= re.findall(r"(\w+)'s page: (\S+)", line)
            yield command, process, addresses
        finally:
            process.kill()
            watchdog.cancel()


def read(run, table):
    return pd.read_parquet(run / "tables" / f"{table}.parquet")


def wait_until(holds):
    """Wait for something that does not go by the clock of rigs."""
    end = time.monotonic() + 30.0
    while not (found := holds()):
        assert time.monotonic() < end, "did not happen in time"
        time.sleep(0.002)
    return found
