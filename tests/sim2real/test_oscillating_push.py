"""An object that is swayed under the fingertip: its plan, and the delay that its way in the picture tells."""

from functools import cache

import numpy as np
import pytest
from sim2real.excitation.contact_suite.contact_motions import SWAY, SWAYS, sway
from sim2real.excitation.contact_suite.suite import SuiteState, task_suite
from sim2real.excitation.contact_suite.tip_path import Oscillation, OutOfReach, make_segment, tip_position
from sim2real.excitation.contact_suite.workspace import RestingObject, Workspace
from sim2real.recordings.signals import Log
from sim2real.task.keypoint_track import KeypointTrack
from sim2real.task.suite.image_latency import estimate_image_latency
from sim2real.task.suite.oscillating_push import find_oscillating_pushes
from sim2real.task.suite.recording import TaskRecording, spans_of

from np_common.rotations import yaw_quaternion
from np_description.camera import CAMERA
from np_description.domains import BUMP, CARD, Pose
from np_description.keypoints import box_keypoints
from np_description.panda import NOMINAL
from np_description.phases import EXCITE, PhaseState

LAIN = Pose(np.array([0.5, -0.05, CARD.half_size[2]]), yaw_quaternion(np.asarray(0.2)))
TALL = Pose(np.array([0.5, -0.14, 0.045]), LAIN.quaternion)


def planned(domain, pose):
    generator = task_suite(domain, SuiteState(NOMINAL.ready, pose), ["sway"])
    return next(generator)[-1]


@cache
def led():
    """The suite's own sway: times (n,) s, joints (n, 7) and the tip's way (n, 3)."""
    plan = planned(CARD, LAIN)
    state = np.arange(0.0, plan.times[-1], 0.01)
    joints = np.column_stack([np.interp(state, plan.times, joint) for joint in plan.positions.T])
    return state, joints, np.array([tip_position(q) for q in joints])


def recorded(late=0.0, follows=1.0, behind=0.0, noise=0.15, seed=1):
    """What is seen of the suite's own sway: the object goes `follows` of the tip's way, and stays behind by up to `behind` m."""
    (state, joints, tips), rng = led(), np.random.default_rng(seed)
    pressed = tips[:, 2] < tips[:, 2].min() + 2e-3
    way = np.zeros((len(state), 2))
    for k in range(1, len(state)):
        goal = follows * (tips[k, :2] - LAIN.position[:2]) * pressed[k]
        left = goal - way[k - 1]
        far = np.linalg.norm(left)
        way[k] = way[k - 1] + (left * max(0.0, 1 - behind / max(far, 1e-9)) if pressed[k] else 0.0)
    time = np.arange(0.0, state[-1], 1 / 30)
    places = np.column_stack([np.interp(time - late, state, axis) for axis in way.T])
    half = np.asarray(CARD.half_size)
    corners = [box_keypoints(half, LAIN.position + [x, y, 0.0], LAIN.quaternion) for x, y in places]
    pixels = CAMERA.project(np.array(corners))[0] + noise * rng.standard_normal((len(time), 8, 2))
    phases = ((0.0, PhaseState(EXCITE, experiment="sway")),)
    log = Log("made", state, joints, 0 * joints, 0 * joints, state, False, phases=phases)
    return TaskRecording(
        log, KeypointTrack("made", time, pixels, np.ones((len(time), 8), bool)), 0.0, CARD, spans_of(log)
    )


def test_a_swing_is_a_sinusoid_that_begins_and_ends_at_rest():
    begin, way = np.array([0.5, 0.1, 0.13]), np.array([0.012, 0.0, 0.0])
    made = make_segment("swing", begin, [Oscillation(way, 1.6, 4, rest=0.5)], 0.0)
    along = np.array([tip_position(q)[0] for q in made.positions]) - begin[0]
    time = made.times
    whole = (time > 0.9) & (time < 5.5)
    assert np.allclose(along[whole], 0.012 * np.sin(2 * np.pi * time[whole] / 1.6), atol=5e-4)
    assert np.abs(along[time > 6.4]).max() < 5e-4 and np.abs(made.velocities[[0, -1]]).max() < 1e-3


def test_a_sway_is_about_where_a_flat_object_is_seen_and_presses_it():
    tips = np.array([tip_position(q) for q in planned(CARD, LAIN).positions])
    low = tips[tips[:, 2] < tips[:, 2].min() + 1e-3]
    assert np.abs(low[:, :2] - LAIN.position[:2]).max() == pytest.approx(SWAY, abs=1e-3)
    assert low[:, 2].max() < 2 * LAIN.position[2]


def test_an_object_that_would_rock_is_not_swayed():
    """A cube of 9 cm that is led by its top with friction of .58 with the table tips over its edge."""
    with pytest.raises(StopIteration):
        planned(BUMP, TALL)
    with pytest.raises(OutOfReach, match="would rock"):
        sway("sway", RestingObject.of(BUMP, TALL), Workspace(BUMP, CAMERA), 0.09)


@pytest.mark.parametrize("late", [0.0, 0.12])
def test_a_sway_tells_the_delay_by_itself(late):
    made = recorded(late)
    (only,), found = find_oscillating_pushes(made), estimate_image_latency([made])
    assert only.counts >= SWAYS[1] - 1
    assert found.late.value == pytest.approx(late, abs=0.004) and found.late.high - found.late.low < 0.025
    assert found.verdict == ("ambiguous" if late else "no_gap")


def test_an_object_that_goes_along_by_half_says_no_delay():
    made = recorded(follows=0.5)
    assert find_oscillating_pushes(made) == () and estimate_image_latency([made]).verdict == "undetermined"


@pytest.mark.parametrize(("behind", "late"), [(0.0003, 0.04), (0.001, 0.0)])
def test_an_object_that_stays_behind_where_the_tip_turns_back_is_not_taken_for_one_that_is_late(behind, late):
    """A millimetre of play looks like 30 ms in a sinusoid's phase."""
    found = estimate_image_latency([recorded(late, behind=behind)])
    assert found.late.low <= late <= found.late.high and abs(found.late.value - late) < 0.008


def test_a_recording_of_before_has_none():
    made = recorded()
    old = TaskRecording(made.log, made.track, 0.0, CARD, {"push_1": made.spans["sway"]})
    assert find_oscillating_pushes(old) == ()
