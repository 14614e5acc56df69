"""The real rig: muscles, load cells and encoders on a Festo CPX-E.

Trials flow in, recordings flow out, sampled at a fixed rate over Modbus. While muscles are under pressure the device's
own watchdog is armed; whatever ends a trial early lets all of them down in a stated time, or, where the device can no
longer be reached, leaves that to the watchdog.
"""

import contextlib
import logging
import socket
import tempfile
from collections.abc import Iterator, Mapping
from typing import Any, ClassVar, Self

import numpy as np
import pandas as pd
from filelock import FileLock, Timeout
from pydantic import PrivateAttr, model_validator

from stages.science.plant.declaration import nearest
from stages.science.rig import clock
from stages.science.rig.attendance import Moment
from stages.science.rig.contract import RigError, TrialStopped, Watch, tidy
from stages.science.rig.festo.channels import ChannelMap, EncoderPlace, MuscleChannels
from stages.science.rig.festo.cpx_link import CpxLink, Device, LinkLost
from stages.science.rig.festo.held_signals import Held, hold_signals
from stages.science.rig.festo.logbook import CountRecording, Logbook
from stages.science.rig.festo.supervision import Sample, Supervisor, judge_held
from stages.science.rig.filling import FillingRig, fill
from stages.science.rig.limits import Guard, apply_limits, check_limits, find_forbidden
from stages.science.rig.pacing import Tick, measure_pace, pace, undisturbed
from stages.science.rig.trial import Recording, Trial
from stages.science.signals.trajectories import Array

log = logging.getLogger("pamid")

FILLED = 0.3
"""Share of its highest command from which on a muscle is filled, so that its load cell should tell."""
LOCK_FOLDER = "/run/lock"
"""Where locks lie, where there is such a folder: a folder for temporary files may be a process's own."""
MOST_TOLD = 5
"""Lines of a refusal that are printed; the others are counted."""


class FestoCpx(FillingRig):
    """A rig on a Festo CPX-E.

    Sensors are read, then the command of the sample is written, which holds until the next one.
    """

    real: ClassVar[bool] = True

    device: Device
    channels: dict[str, MuscleChannels]
    encoders: dict[str, EncoderPlace]
    co_contraction_kpa: dict[str, float]
    guard: Guard
    _link: CpxLink | None = PrivateAttr(default=None)
    _lock: Any = PrivateAttr(default=None)

    @model_validator(mode="after")
    def _check_fit(self) -> Self:
        check_limits(self.limits, self.exoskeleton.muscles)
        self.guard.check_against(self.exoskeleton, self.limits)
        self.map_channels().check_against(self.limits, self.guard, self.device.counts)
        for joint in self.exoskeleton.joint_names:
            if joint not in self.co_contraction_kpa:
                raise ValueError(f"co_contraction_kpa: none for joint {joint}; add co_contraction_kpa.{joint}")
        self._check_filling()
        return self

    def map_channels(self) -> ChannelMap:
        """Return the channels of all muscles and joints."""
        return ChannelMap(self.exoskeleton, self.device.modules, self.channels, self.encoders)

    def connect(self) -> None:
        """Take the device for this process alone, check its modules and vent all muscles.

        A `RigError` tells that another process holds it, or that it does not answer as it should.
        """
        if self._link is not None:
            return
        lock, link = _take(self.device), CpxLink(self.device, self.map_channels())
        try:
            link.open()
        except BaseException:
            link.close()
            lock.release()
            raise
        self._lock, self._link, self._connected = lock, link, True

    def release(self) -> None:
        """Vent all muscles, let the watchdog rest and give the device back, each being tried."""
        link, lock = self._link, self._lock
        self._link = self._lock = None
        self._connected = False
        try:
            if link is not None:
                link.let_go()
        finally:
            if lock is not None:
                lock.release()

    def check(self, trial: Trial) -> None:
        """Check a trial against shapes and limits, before anything moves."""
        super().check(trial)
        if trial.reference_rad is None:
            return
        columns = {
            "trial": trial.label or trial.kind,
            "time_s": np.tile(np.arange(self.samples) / self.sampling_rate_hz, len(self.muscles)),
            "muscle": np.repeat(self.muscles, self.samples),
            "pressure_command_kpa": trial.pressure_command_kpa.T.ravel(),
            "joint_angle_rad": trial.reference_rad[:, self.exoskeleton.joint_of_muscle].T.ravel(),
        }
        self.check_bank(pd.DataFrame(columns), "trial")

    def check_bank(self, samples: pd.DataFrame, by: str) -> None:
        """Refuse movements that ask for what the limits forbid, before anything moves."""
        lines = list(find_forbidden(samples, by, self.exoskeleton, self.guard, self.limits))
        if lines:
            more = f"; and {len(lines) - MOST_TOLD} more" if len(lines) > MOST_TOLD else ""
            raise ValueError(
                f"expected movements within the rig's limits: {'; '.join(lines[:MOST_TOLD])}{more}; "
                "leave them out of the bank or change rig.limits and rig.guard"
            )

    def run(self, trial: Trial, generator: np.random.Generator, watch: Watch | None) -> Recording:
        """Execute one trial; `TrialStopped` tells that a limit, a sensor, the link or the loop's pace ended it."""
        asked, ceilings = trial.pressure_command_kpa, self.co_contraction_kpa
        applied, clipped = apply_limits(asked, self.limits, self.exoskeleton, ceilings)
        filling = fill(applied[0], self._lead_samples, self.filling_share)
        command = np.concatenate([filling, applied])
        clipped = np.concatenate([np.full(filling.shape, "ramp", dtype=clipped.dtype), clipped])
        book = Logbook(self, len(filling), command, clipped, watch)
        with hold_signals() as signals, undisturbed():
            reason = self._conduct(trial, command, book, signals)
        if reason:
            when = f"{book.time_s:.2f} s into the trial" if book.time_s >= 0 else "while the muscles were being filled"
            advice = "" if self.attendance.why_stop() else "; find out why before anybody goes on"
            raise TrialStopped(f"stopped {when}: {reason}{advice}", book.noticed_at_s)
        recording = book.collect()
        log.info("%s: %s", trial.label or trial.kind, measure_pace(pd.DataFrame(tidy(recording, self)), []))
        for told in self._find_dead(recording):
            log.warning("%s: %s", trial.label or trial.kind, told)
        return recording

    def _find_dead(self, recording: Recording) -> Iterator[str]:
        """Say which load cells told the same throughout though their muscle was filled; a slack muscle does so too."""
        for m, muscle in enumerate(self.exoskeleton.muscles):
            highest = float(recording.pressure_kpa[:, m].max())
            if np.ptp(recording.force_n[:, m]) == 0.0 and highest > FILLED * self.limits[muscle.type].high_kpa:
                yield (
                    f"{muscle.name}.force was {recording.force_n[0, m]:.3g} N throughout, at up to {highest:.0f} kPa: "
                    "the muscle was slack, or its load cell is not connected"
                )

    def read_counts(self, record_s: float) -> CountRecording:
        """Record the raw counts of all inputs for a time, s, at the sampling rate; no output is touched.

        A `RigError` tells that the rig is not connected or the device does not answer.
        """
        link, rate_hz = self._linked(), self.sampling_rate_hz
        ticks = pace(max(round(record_s * rate_hz), 2), 1.0 / rate_hz)
        try:
            taken = {tick.index / rate_hz: link.read() for tick in ticks}
        except LinkLost as error:
            raise RigError(
                f"the device at {link.place} does not answer ({error}); check its power and its cable"
            ) from None
        return CountRecording(_tabulate(taken, link))

    def hold(
        self, muscle: str, command_kpa: float, record_s: float, *, ramp_s: float, settle_s: float
    ) -> CountRecording:
        """Hold one muscle at a command, kPa gauge, all others vented, and record the raw counts of all inputs.

        It is filled and let down in `ramp_s`, longer where its limit on the rate asks for it, and recorded for a time,
        s, from `settle_s` after the filling on; meanwhile the device's watchdog is armed. The recording says where a
        ceiling, a sensor at its end or a late loop had the muscle let down early, as far as channels that are not
        calibrated yet can tell, in the guard's time at most.

        A `ValueError` tells that there is no such muscle, or that the command is beyond its limits; nothing was
        commanded then. A `RigError` tells that the rig is not connected, that the device does not answer, or that it
        could not be reached to let the muscle down: then its watchdog does.
        """
        link, rate_hz, period_s = self._linked(), self.sampling_rate_hz, 1.0 / self.sampling_rate_hz
        if muscle not in self.muscles:
            raise ValueError(f"no muscle '{muscle}'; {nearest(muscle, self.muscles)}")
        number = list(self.muscles).index(muscle)
        kinds = [each.type for each in self.exoskeleton.muscles]
        kind, limit = kinds[number], self.limits[kinds[number]]
        if not limit.low_kpa <= command_kpa <= limit.high_kpa:
            raise ValueError(
                f"{muscle}: expected {limit.low_kpa} to {limit.high_kpa} kPa (rig.limits.{kind}), got {command_kpa}"
            )
        ceilings = [self.guard.ceilings[each] for each in kinds]
        ramp_s = max(ramp_s, command_kpa / limit.slew_kpa_per_s)
        rise, first = max(round(ramp_s * rate_hz), 1), round((ramp_s + settle_s) * rate_hz)
        target = np.where(np.arange(len(kinds)) == number, command_kpa, 0.0)
        taken: dict[float, Array] = {}
        reason, lost, share = "", "", 0.0
        with hold_signals() as signals:
            try:
                link.arm()
                for tick in pace(first + max(round(record_s * rate_hz), 2), period_s):
                    silent_s = link.longest_silence_s
                    if silent_s > 0.5 * self.device.watchdog_s:
                        reason = f"the loop came {1e3 * silent_s:.0f} ms late (half the watchdog's time is borne)"
                        break
                    counts = link.read()
                    reason = signals.name or judge_held(link.channels, self.device.counts, ceilings, number, counts)
                    if reason:
                        break
                    share = min((tick.index + 1) / rise, 1.0)
                    link.write(share * target)
                    if tick.index >= first:
                        taken[(tick.index - first) * period_s] = counts
            except LinkLost as error:
                lost = str(error)
            finally:
                down_s = min(ramp_s * share, self.guard.ramp_down_s if reason else np.inf)
                unreached = link.depressurise(share * target, max(down_s, period_s), period_s, lambda *_: None, lost)
        with contextlib.suppress(LinkLost):  # an armed watchdog vents what is vented already
            link.disarm()
        if lost or unreached:
            late = f"its watchdog lets the muscle down, {self.device.watchdog_s} s after the last request"
            how = late if unreached else "it was let down"
            raise RigError(
                f"the device at {link.place} does not answer ({lost or unreached}); {how}; see that the muscles are "
                "without air before anybody goes on"
            )
        return CountRecording(_tabulate(taken, link), link.channels.to_counts(target)[number], reason)

    def _linked(self) -> CpxLink:
        if self._link is None:
            raise RigError("FestoCpx is not connected; write: with rig: rig.read_counts(2.0)")
        return self._link

    def announce(self, trial: Trial) -> None:
        """Tell whoever shows the trial to the person that it begins, with the lead-in."""

    def _conduct(self, trial: Trial, command: Array, book: Logbook, signals: Held) -> str:
        """Run the loop, let the muscles down, and return why it ended early; empty where it did not."""
        link = self._linked()
        supervisor = Supervisor(link.channels, self.device.counts, self.guard, moved=trial.kind != "passive")
        step = np.array([self.limits[each.type].slew_kpa_per_s for each in self.exoskeleton.muscles])
        step = step / self.sampling_rate_hz
        gentle = np.diff(command[: book.lead], axis=0, prepend=0.0).max(axis=0)
        reason = broken = ""
        try:
            self.announce(trial)
            link.arm()
            for tick in pace(len(command), 1.0 / self.sampling_rate_hz):
                if tick.index == 0:
                    self.attendance.begin(trial, tick.due_s + self.lead_in_s)
                counts = link.read()
                late_s = tick.late_s
                reason = signals.name or self.attendance.why_stop() or self._judge_pace(book, tick, late_s)
                if reason:
                    break
                sample = supervisor.look(counts, book.last_command, tick.due_s + late_s)
                reason = sample.breach
                given = None if reason else book.next_command(tick.index, gentle if tick.index < book.lead else step)
                if given:
                    link.write(given[0])
                book.note(tick, late_s, sample, given)
                self._show_sample(book, sample, book.last_command)
                if reason:
                    break
            reason = reason or link.find_other_master()
        except LinkLost as error:
            broken = str(error)
            reason = f"the device at {link.place} does not answer as it should ({broken})"
        finally:
            book.noticed_at_s = clock.now_s()
            lost = self._let_down(link, supervisor, book, broken)
        book.hand_over()
        if lost:
            return f"{reason or 'the trial was over'}; {lost}"
        return f"{reason}; the muscles were let down" if reason else ""

    def _show_sample(self, book: Logbook, sample: Sample, command_kpa: Array) -> None:
        shown = Moment(book.time_s, sample.joint_angle_rad, command_kpa, sample.pressure_kpa, sample.force_n)
        self.attendance.show(shown)

    def _judge_pace(self, book: Logbook, tick: Tick, late_s: float) -> str:
        """Say that the loop slept for so long that the device may have vented meanwhile, or missed too much."""
        slept_s = (tick.index - book.count) / self.sampling_rate_hz + late_s
        if book.count and slept_s > 0.5 * self.device.watchdog_s:
            return f"the loop came {1e3 * slept_s:.0f} ms late (half the watchdog's time is borne)"
        if book.missed > self.guard.missed_share * len(book.command_kpa):
            return (
                f"the loop missed {book.missed} samples of {len(book.command_kpa)}, more than rig.guard.missed_share "
                f"({self.guard.missed_share}): the device or this computer is too slow for {self.sampling_rate_hz} Hz"
            )
        return ""

    def _let_down(self, link: CpxLink, supervisor: Supervisor, book: Logbook, broken: str) -> str:
        """Let all muscles down within the guard's time and see them down; say so where that failed."""
        begun = clock.now_s()

        def look(counts: Array, command_kpa: Array) -> None:
            sample = supervisor.look(counts, command_kpa, clock.now_s())
            book.note_ramp(sample, command_kpa)
            self._show_sample(book, sample, command_kpa)

        period_s = 1.0 / self.sampling_rate_hz
        problem = link.depressurise(book.last_command, self.guard.ramp_down_s, period_s, look, broken)
        if problem:
            return (
                f"the muscles could not be let down ({problem}): the watchdog does, {self.device.watchdog_s} s after "
                "the last request"
            )
        return self._see_down(link, begun + self.guard.ramp_down_s)

    def _see_down(self, link: CpxLink, commanded_at_s: float) -> str:
        """Wait until the measured pressures are low, then disarm the watchdog; say which pressure is not low."""
        while True:
            try:
                pressure, _, _ = link.channels.to_values(link.read())
            except LinkLost as error:
                return f"the muscles were let down, but the device does not answer any more ({error})"
            measured = zip(self.muscles, pressure, strict=True)
            up = [f"{name} at {value:.0f} kPa" for name, value in measured if value > self.guard.vented_kpa]
            if not up:
                with contextlib.suppress(LinkLost):  # an armed watchdog vents what is vented already
                    link.disarm()
                return ""
            if clock.now_s() - commanded_at_s > self.guard.vented_within_s:
                return (
                    f"{' and '.join(up)} {self.guard.vented_within_s} s after all were commanded 0: close the air "
                    "(rig.guard.vented_kpa)"
                )
            clock.sleep(1.0 / self.sampling_rate_hz)


def _tabulate(taken: Mapping[float, Array], link: CpxLink) -> pd.DataFrame:
    at_s = pd.Index(taken, dtype=float, name="time_s")
    return pd.DataFrame(list(taken.values()), at_s, link.channels.names, dtype=float)


def _take(device: Device) -> FileLock:
    """Take a device for this process alone."""
    try:
        address = socket.gethostbyname(device.host)
    except OSError as error:
        raise RigError(
            f"rig.device.host: expected an address or a name that can be found, got {device.host} ({error})"
        ) from None
    path = f"{_find_lock_folder()}/pamid-{address}-{device.port}.lock"
    lock = FileLock(path, mode=0o666)
    try:
        lock.acquire(timeout=0.0)
    except Timeout:
        raise RigError(
            f"{device.host}:{device.port} is driven by another process (it holds {path}); wait until that ends, "
            "and have a sweep run one job at a time: hydra.launcher.n_jobs=1"
        ) from None
    except OSError as error:
        raise RigError(
            f"{path}: expected a lock file that this user may write ({error.strerror}); once nobody drives "
            f"{device.host}:{device.port}, have its owner remove it"
        ) from None
    return lock


def _find_lock_folder() -> str:
    """Return a folder that all users and processes of this computer share, if there is one."""
    try:
        with tempfile.TemporaryFile(dir=LOCK_FOLDER):
            return LOCK_FOLDER
    except OSError:
        return tempfile.gettempdir()
