"""LeRobot's own command records the simulated FR3 on its network protocol, behind the driver."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
from approach import Episode
from lerobot_tools import ALLOWED, MARKS, load, record
from measured import Measurement
from moving_arm import MovingArm

from np_description.panda import JOINT_NAMES, STATE_NAMES

pytestmark = MARKS
RECORDED = 60  # s, of the machine's clock
MOVES = 0.01  # rad/s: two states of an arm at rest can be equal


def against(log: np.ndarray, state: np.ndarray) -> dict[str, np.ndarray]:
    """Frames of a data set against the robot's own log, each with the row nearest to it.

    log: rows of `MovingArm.trace`; state (N, 27 and more): `observation.state`. The row (N,) of each
    frame, whether the arm `moves` in it (N,), and the differences (N, 7) of position rad, velocity rad/s and torque without gravity Nm.
    """
    count = len(JOINT_NAMES)
    parts = [state[:, i * len(STATE_NAMES) :][:, :count] for i in range(3)]
    logged = np.split(log[:, 1 : 1 + 3 * count], 3, axis=1)
    motion, rows = np.hstack(logged[:2]), np.hstack(parts[:2])
    at = np.array([np.abs(motion - row).max(axis=1).argmin() for row in rows])
    differences = (np.abs(theirs[at] - ours) for theirs, ours in zip(logged, parts))
    moves = np.abs(parts[1]).max(axis=1) > MOVES
    return {"row": at, "moves": moves, **dict(zip(("position", "velocity", "torque"), differences))}


def test_every_recorded_frame_is_a_state_of_the_robot_s_own_log(tmp_path):
    """Phases pre and approach of a card that is shown: the robot has neither object nor camera."""
    with MovingArm("topic", priority=True) as arm, ThreadPoolExecutor() as pool:
        episode = Episode(arm, seed=0)
        now = Measurement(arm).now
        episode.place(now())
        recording = pool.submit(record, arm.harness.graph, tmp_path / "card", RECORDED)
        arm.harness.probe.wait_until(lambda: episode.shows(now) or recording.done(), ALLOWED, "the approach's end")
        recording.result()
        log = arm.trace()
        found = load(arm.harness.graph, tmp_path / "card")
    state, action = found["observation.state"], found["action"]
    assert found["fps"] == 10 and found["episodes"] == 1 and len(state) == len(action) > RECORDED
    assert np.ptp(state[:, 1]) > 0.3  # rad
    frames = against(log, state)
    assert frames["position"].max() < 1e-6 and frames["velocity"].max() < 1e-6  # the protocol carries float32
    assert np.sqrt((frames["torque"] ** 2).mean()) < 0.01  # Nm; two models of gravity
    assert (np.diff(frames["row"][frames["moves"]]) > 0).all() and frames["moves"].sum() > 20
