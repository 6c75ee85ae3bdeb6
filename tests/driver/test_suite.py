"""The diagnosis suite runs through the driver as through any backend: same command, a recording that keeps
the contract."""

import numpy as np
import pytest
import suite
from moving_arm import MovingArm
from sim2real.arm.model import panda
from sim2real.checks.plausibility import check_plausibility
from sim2real.excitation.suite import make_suite as experiments
from sim2real.recordings.reading import load_log

from np_record.bag import Recording

EXPERIMENT = "sinusoid_7"


@pytest.mark.parametrize("control", ["topic", "onboard"])
def test_an_experiment_is_followed_recorded_and_read(tmp_path, control):
    with MovingArm(control, priority=True) as arm:  # the command and its recorder start beside a running loop
        arm.deafen()
        recorded = suite.record(arm, tmp_path, [EXPERIMENT])
    assert recorded["segments"][-1] == EXPERIMENT  # after a transfer, if there must be one
    (expected,) = experiments([EXPERIMENT])
    log = load_log(recorded["bag"])
    check_plausibility(log, panda())
    assert log.duration > expected.duration
    swing = np.ptp(expected.positions[:, 6])
    assert np.ptp(log.position[:, 6]) == pytest.approx(swing, rel=0.1)
    assert np.ptp(log.commands.target[:, 6]) == pytest.approx(swing, rel=0.01)
    with Recording(recorded["bag"]) as recording:
        names = {message.topic.name for message in recording.messages()}
    assert {"joint_states", "motor_states", "effort_command", "applied_command", "episode/tick"} <= names
