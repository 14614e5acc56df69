import re
from typing import ClassVar

import numpy as np
import pandas as pd
import pytest
from pydantic import PrivateAttr

from pipeline.errors import TableError
from pipeline.table import Table
from stages.science.rig.contract import RECORDING_COLUMNS, Rig, RigError, tidy
from stages.science.rig.trial import Recording, Trial
from tests.science.plant.machines import configured, other_machine


class Bench(Rig):
    """A rig of three muscles on two joints that notes what is done to it, and fails at it where that is wanted."""

    real: ClassVar[bool] = False
    _faults: dict = PrivateAttr()
    _log: list = PrivateAttr(default_factory=list)

    def __init__(self, **faults):
        machine, people = other_machine([2, 1], rate=50.0, trial_s=0.08), configured().participants
        super().__init__(exoskeleton=machine, participants={"ann": people["p1"]})
        self._faults = faults

    def act(self, what):
        self._log.append(what)
        if what in self._faults:
            raise self._faults[what]

    def connect(self):
        super().connect()
        self.act("connect")

    def release(self):
        super().release()
        self.act("release")

    def run(self, trial, generator, watch):
        if "run" in self._faults:
            raise self._faults["run"]
        muscles, joints = np.arange(12.0).reshape(4, 3), np.arange(8.0).reshape(4, 2) / 10
        return Recording(np.arange(4) / 50, muscles, muscles + 0.5, *([muscles / 100] * 2), muscles, joints, joints)


def trial(kind="free", participant="ann", samples=4, muscles=3, **more):
    return Trial(kind, participant, np.zeros((samples, muscles)), **more)


def test_the_block_connects_and_releases_and_is_needed(generator):
    bench = Bench()
    with pytest.raises(RigError, match=r"Bench is not connected; write: with rig: rig.execute\(trial, generator\)"):
        bench.execute(trial(), generator)
    with bench as rig:
        assert rig.execute(trial(), generator).force_n.shape == (4, 3)
        assert bench._log == ["connect"]
    assert bench._log == ["connect", "release"]


@pytest.mark.parametrize("fault", [ValueError("sensor"), KeyboardInterrupt(), SystemExit(3)])
def test_any_exception_in_a_trial_releases(generator, fault):
    bench = Bench(run=fault)
    bench.connect()
    with pytest.raises(type(fault)):
        bench.execute(trial(), generator)
    assert bench._log == ["connect", "release"]
    assert not bench.connected


@pytest.mark.parametrize("fault", ["connect", "release"])
def test_a_failed_connection_releases_and_an_error_on_release_alone_is_raised(fault):
    bench = Bench(**{fault: OSError("no route")})
    with pytest.raises(OSError, match="no route"), bench:
        pass
    assert bench._log == ["connect", "release"]


def test_the_first_error_is_raised_and_the_second_noted(generator):
    bench = Bench(run=ValueError("sensor"), release=OSError("valve stuck"))
    with pytest.raises(ValueError, match="sensor") as caught, bench:
        bench.execute(trial(), generator)
    assert "valve stuck" in caught.value.__notes__[0]


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: trial(kind="idle"), "expected free, tracked or passive, got 'idle'"),
        (lambda: trial(kind="tracked"), "a tracked trial takes a reference_rad"),
        (lambda: trial(reference_rad=np.zeros((4, 2))), "a free trial takes no reference_rad"),
        (lambda: trial(kind="tracked", reference_rad=np.zeros((5, 2))), "reference_rad has 5 samples"),
        (lambda: Trial("free", "ann", np.zeros(4)), "expected a matrix of samples by columns, got shape (4,)"),
        (lambda: Trial("free", "ann", np.array([[0.0], [np.nan]])), "expected finite numbers, got [nan] at sample 1"),
    ],
)
def test_an_ill_formed_trial_is_refused(make, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        make()


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (trial(samples=5), "this rig takes 4 samples of 3 muscles, got shape (5, 3)"),
        (trial(muscles=2), "this rig takes 4 samples of 3 muscles, got shape (4, 2)"),
        (trial(kind="tracked", reference_rad=np.zeros((4, 3))), "4 samples of 2 joints, got shape (4, 3)"),
        (trial(participant="bob"), "no participant 'bob'; this rig knows ann, experimenter"),
        (trial(participant="nobody"), "'nobody' goes with passive, and only there"),
        (trial(kind="passive"), "'nobody' goes with passive, and only there"),
    ],
)
def test_a_trial_that_does_not_fit_is_refused(generator, given, message):
    with pytest.raises(ValueError, match=re.escape(message)), Bench() as bench:
        bench.execute(given, generator)


def test_a_recording_of_unequal_shapes_is_refused():
    square = np.zeros((4, 3))
    with pytest.raises(ValueError, match=r"expected force_n of shape \(4, 3\), got \(4, 2\)"):
        Recording(np.zeros(4), square, square, square, square, np.zeros((4, 2)), np.zeros((4, 1)), np.zeros((4, 1)))


def test_tidy_is_long_muscle_by_muscle_with_the_muscles_joint(generator):
    with Bench() as bench:
        recording = bench.execute(trial(), generator)
    frame = pd.DataFrame(tidy(recording, bench))
    assert list(frame.columns) == list(RECORDING_COLUMNS)
    assert frame["muscle"].tolist() == ["muscle00"] * 4 + ["muscle01"] * 4 + ["muscle10"] * 4
    assert frame["time_s"].tolist() == [0.0, 0.02, 0.04, 0.06] * 3
    for column, name in enumerate(bench.muscles):
        rows = frame[frame["muscle"] == name]
        assert rows["pressure_kpa"].to_numpy() == pytest.approx(recording.pressure_kpa[:, column])
        assert rows["joint_angle_rad"].to_numpy() == pytest.approx(recording.joint_angle_rad[:, [0, 0, 1][column]])


def test_the_columns_are_described_end_with_their_units_and_check_types_and_ranges(generator):
    for name, column in RECORDING_COLUMNS.items():
        assert column["description"]
        unit = column["unit"].lower().replace("/", "_per_").replace("1_per_", "per_")
        assert unit == "1" or name.endswith(unit)
    with Bench() as bench:
        frame = pd.DataFrame(tidy(bench.execute(trial(), generator), bench))
    table = Table("recorded", "A sample", RECORDING_COLUMNS)
    table.check(frame, "here")
    for column, wrong in (("force_n", -1.0), ("pressure_kpa", 2000.0), ("contraction", np.nan)):
        broken = frame.copy()
        broken.loc[3, column] = wrong
        with pytest.raises(TableError, match=f"column {column}: expected"):
            table.check(broken, "here")
