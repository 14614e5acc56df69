"""What a trial notes of a loop that does not keep its rate."""

import numpy as np

from stages.science.rig.festo.logbook import Logbook
from stages.science.rig.festo.supervision import Sample
from stages.science.rig.pacing import Tick
from tests.science.plant.machines import configured


def test_a_sample_that_is_late_by_more_than_a_period_says_so_unless_a_sensor_is_amiss():
    machine = configured().exoskeleton
    muscles, joints = len(machine.muscles), len(machine.joints)
    period_s = 1.0 / machine.sampling_rate_hz
    command = np.full((3, muscles), 100.0)
    logbook = Logbook(machine, 0, command, np.full(command.shape, ""), None)
    status = np.array(["ok"] * (muscles - 1) + ["held"])
    sample = Sample(np.ones(muscles), np.ones(muscles), np.zeros(joints), np.zeros(joints), status, "")
    for index, late in enumerate((0.5, 1.5, 0.0)):
        logbook.note(Tick(index, index * period_s), late * period_s, sample, (command[index], np.array("")))
    taken = logbook.collect()
    assert [list(row) for row in taken.status] == [
        list(status),
        ["late"] * (muscles - 1) + ["held"],
        list(status),
    ]
    np.testing.assert_array_equal(taken.late_s, np.array([0.5, 1.5, 0.0]) * period_s)
