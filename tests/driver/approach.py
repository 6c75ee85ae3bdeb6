"""The approach of a card episode through the driver: keypoints of a card at rest, real weights, RRT*."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from measured import Measurement, overheard
from moving_arm import MovingArm
from sensor_msgs.msg import PointCloud2
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory

from np_common.rotations import quaternion_from_matrix, rotation_angle
from np_control.kinematics import forward_kinematics
from np_description.camera import CAMERA
from np_description.domains import find_domain, sample_task
from np_description.keypoints import box_keypoints
from np_description.message_arrays import pose_arrays, trajectory_arrays
from np_description.panda import BASE_FRAME, JOINT_NAMES
from np_description.phases import FAILED, FAULT, POST
from np_description.scene import CAMERA_NAME
from np_ros import qos
from np_ros.messages import keypoints_message, pose_message
from np_ros.phases import phase_state

DOMAIN = find_domain("card")
START_TIMEOUT = 600.0  # s: the nodes start with what the running loop and others leave of the processors
SHOWN_EVERY = 0.03  # s between two sets of keypoints, as from a detector


class Episode:
    """The nodes `episode`, `pre_contact` and `approach` beside an arm, and a card that they are shown."""

    def __init__(self, arm: MovingArm, seed: int):
        self._arm, self._probe = arm, arm.harness.probe
        self._start, self._goal = sample_task(DOMAIN, np.random.default_rng(seed))
        probe = self._probe
        self.phases = probe.collect("episode/phase", DiagnosticArray, qos.LATCHED)
        self.plans = probe.collect("joint_trajectory", JointTrajectory, qos.EVENT)
        self.poses = probe.collect("pre_contact_pose", PoseStamped, qos.EVENT)
        probe.advertise("keypoints", PointCloud2)
        probe.advertise("goal_pose", PoseStamped, qos.LATCHED)
        graph = arm.harness.graph
        probe.wait_until_ready(
            {
                graph.run("np_policy", name, {"mode": "realtime", **more})
                for name, more in (
                    ("pre_contact", {}),
                    ("approach", {"seed": seed}),
                    ("episode", {"backend": "franka_driver"}),
                )
            },
            START_TIMEOUT,
        )

    def place(self, stamp: int) -> None:
        """Say where the card is to go; stamp: ns."""
        self._probe.publish(
            "goal_pose", pose_message(stamp, BASE_FRAME, self._goal.position, self._goal.quaternion), qos.LATCHED
        )
        self.phases.clear()  # holding the arm anew says `fault` and `idle` there itself

    def shows(self, now: Callable[[], int]) -> bool:
        """Show the card once, as seen at `now` ns; whether the approach is over. RuntimeError where it failed."""
        corners, _ = CAMERA.project(
            box_keypoints(np.asarray(DOMAIN.half_size), self._start.position, self._start.quaternion)
        )
        seen = np.column_stack([corners, np.ones(len(corners))])
        self._probe.publish("keypoints", keypoints_message(now(), CAMERA_NAME, seen))
        self._probe.idle_for(SHOWN_EVERY)
        said = [phase_state(message) for message in self.phases]
        if ended := [state for state in said if state.phase in (FAILED, FAULT)]:
            raise RuntimeError(f"the approach ended with {ended[0]}")
        return any(state.phase == POST for state in said)

    def run(self, now: Callable[[], int]) -> None:
        """Start, and show the card until the phase `post`; now: stamp ns of what is shown. RuntimeError where
        the episode comes to another end."""
        self.place(now())
        answer = self._probe.node.create_client(Trigger, "episode/start").call_async(Trigger.Request())
        self._arm.harness.wait(lambda: self.shows(now), "the end of the approach")
        assert answer.done() and answer.result().success, answer

    def result(self) -> dict[str, object]:
        """Where the arm has come to, against the end of the plan and the pose that was asked for."""
        _, planned, _ = trajectory_arrays(self.plans[-1], JOINT_NAMES)
        position, quaternion = pose_arrays(self.poses[-1], BASE_FRAME)
        q = np.array(self._arm.robot.request("state")["q"])
        at, rotation = forward_kinematics(q)
        angle = rotation_angle(quaternion, quaternion_from_matrix(rotation))
        duration = self.plans[-1].points[-1].time_from_start
        return {
            "phases": [str(phase_state(message)) for message in self.phases],
            "plan_s": round(duration.sec + duration.nanosec * 1e-9, 2),
            "plan_points": len(planned),
            "end_joint_error_rad": round(float(np.abs(planned[-1] - q).max()), 5),
            "end_hand_error_mm": round(float(1e3 * np.linalg.norm(at - position)), 2),
            "end_hand_error_deg": round(float(np.degrees(angle)), 2),
        }


def approach(control: str, pace: float = 1.0, seed: int = 0) -> dict[str, object]:
    """Phases pre and approach of a card episode; the figures."""
    with MovingArm(control, pace=pace, priority=True) as arm:
        episode = Episode(arm, seed)
        measurement = Measurement(arm)
        with overheard(arm) as raw:
            episode.run(measurement.now)
            arm.rest()
        return {"control": control, **episode.result(), **measurement.row(raw)}
