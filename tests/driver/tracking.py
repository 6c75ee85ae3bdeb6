"""A minute of impedance tracking through the driver."""

from __future__ import annotations

import numpy as np
from measured import Measurement, overheard
from moving_arm import MovingArm

from np_description.panda import JOINT_NAMES, NOMINAL
from np_ros import qos
from np_ros.messages import trajectory_message

PIECE = 10.0  # s of one trajectory
PAUSE = 0.2  # s between two
AMPLITUDE = np.array([0.35, 0.25, 0.3, 0.3, 0.35, 0.3, 0.5])  # rad
FREQUENCIES = 0.1, 0.4  # Hz, of the waves


def waves(begin: np.ndarray, number: int, step: float = 0.05) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A trajectory of PIECE s about `begin` (7,) rad, at rest at both ends: two waves a joint, other ones
    each time.
    """
    times = np.linspace(0, PIECE, round(PIECE / step) + 1)[:, None]
    rng = np.random.default_rng(number)
    window, slope = np.sin(np.pi * times / PIECE) ** 2, np.pi / PIECE * np.sin(2 * np.pi * times / PIECE)
    shape, rate = np.zeros((len(times), 7)), np.zeros((len(times), 7))
    for frequency in rng.uniform(*FREQUENCIES, (2, 7)):
        phase = 2 * np.pi * frequency * times + rng.uniform(0, 2 * np.pi, 7)
        shape += 0.5 * np.sin(phase)
        rate += np.pi * frequency * np.cos(phase)
    velocities = AMPLITUDE * (window * rate + slope * shape)
    velocities[[0, -1]] = 0.0
    return times[:, 0], begin + AMPLITUDE * window * shape, velocities


def track(control: str, seconds: float, pace: float = 1.0) -> dict[str, object]:
    """Impedance tracking for so long of the robot's time; the figures."""
    with MovingArm(control, pace=pace, priority=True) as arm:
        probe = arm.harness.probe
        measurement = Measurement(arm)
        with overheard(arm) as raw:
            for number in range(round(seconds / PIECE)):
                message = trajectory_message(0, JOINT_NAMES, *waves(NOMINAL.ready, number))
                probe.publish("joint_trajectory", message, qos.EVENT)
                last = arm.robot.request("state")["time"] + PIECE + PAUSE
                probe.wait_until(lambda: arm.state()["time"] > last, 100 * PIECE, "the end of a trajectory")
        return {"control": control, "seconds": seconds, **measurement.row(raw)}
