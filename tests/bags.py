"""A recorded episode made by hand, for tests of what reads bags."""

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.serialization import serialize_message

from np_common.rotations import yaw_quaternion
from np_control.impedance import STIFFNESS_MAX
from np_description.camera import CAMERA
from np_description.domains import CARD, Pose
from np_description.keypoints import box_keypoints
from np_description.panda import BASE_FRAME, JOINT_NAMES, NOMINAL, STATE_NAMES
from np_description.phases import PhaseState
from np_record.bag_writer import BagWriter
from np_record.recorder import Sequencer
from np_record.topics import BY_NAME, TIMELINE
from np_ros.messages import image_message, joint_state_message, keypoints_message, pose_message, wrench_message
from np_ros.phases import phase_message

PERIOD = 2_000_000
READY = np.append(NOMINAL.ready, [0.02, 0.02])
GOAL = Pose(np.array([0.55, 0.05, 0.0025]), yaw_quaternion(np.asarray(0.9)))
PHASES = {step: PhaseState(name) for step, name in ((0, "pre"), (50, "approach"), (550, "post"), (1450, "succeeded"))}
KEYPOINT_OFFSET = 1.5  # px, in u


def brightness(image: int) -> int:
    """Of all pixels of a numbered image: each differs from the one before."""
    return 60 + 20 * image % 120


def object_pose(step: int, count: int) -> Pose:
    """The object slides from its start to the goal during the last two thirds of the episode."""
    share = np.clip((step / count - 0.35) / 0.6, 0, 1)
    start = Pose(np.array([0.45, -0.08, 0.0025]), yaw_quaternion(np.asarray(0.1)))
    return Pose(
        start.position + share * (GOAL.position - start.position),
        yaw_quaternion(np.asarray(0.1 + 0.8 * share)),
    )


def joints(time):
    """Position, velocity and effort (..., 9) of the joints at times (...) s, and the target (..., 7) that the impedance law has for them."""
    angle = np.asarray(time)[..., None] + np.arange(9)
    position, effort = READY + 0.1 * np.sin(angle), 5 * np.sin(angle)
    return position, 0.1 * np.cos(angle), effort, position[..., :7] + effort[..., :7] / STIFFNESS_MAX


def record_episode(path, count=1500, phases=PHASES, information=None, leave_out=(), lost=(), reports=None):
    """Write a bag of `count` control periods, without the topics in `leave_out`, to `path` and return it.

    lost: steps without state and command. reports: {step: {node: values}}, messages on `diagnostics`.
    """
    writer = BagWriter(path, {"seed": 0, "domain": "card", "image_rate": 10, **(information or {})})
    sequencer = Sequencer(writer.write)

    def add(name, step, message):
        if name not in leave_out and not (step in lost and name in ("joint_states", "effort_command")):
            sequencer.add(BY_NAME[name], serialize_message(message), step * 1000 + (name != TIMELINE.name))

    for step in range(count):
        stamp, time = step * PERIOD, step * PERIOD / 1e9
        position, speed, effort, target = joints(time)
        add("joint_states", step, joint_state_message(stamp, STATE_NAMES, position, speed, effort))
        add("external_wrench", step, wrench_message(stamp, BASE_FRAME, 6 * effort[:6]))
        answer = joint_state_message(stamp, JOINT_NAMES, target, speed[:7], effort[:7])
        add("effort_command", step, answer)
        for node, values in (reports or {}).get(step, {}).items():
            pairs = [KeyValue(key=key, value=str(value)) for key, value in values.items()]
            status = DiagnosticStatus(name=f"/{node}", message="running", values=pairs)
            add("diagnostics", step, DiagnosticArray(status=[status]))
        if step in phases:
            add("episode/phase", step, phase_message(phases[step]))
        if step == 0:
            add("goal_pose", step, pose_message(stamp, BASE_FRAME, GOAL.position, GOAL.quaternion))
        if step % 50 == 0:
            pose = object_pose(step, count)
            corners = CAMERA.project(box_keypoints(np.asarray(CARD.half_size), pose.position, pose.quaternion))[0]
            keypoints = np.column_stack([corners + [KEYPOINT_OFFSET, 0], np.full(8, 0.9)])
            image = np.full((CAMERA.height, CAMERA.width, 3), brightness(step // 50), np.uint8)
            add("object_pose", step, pose_message(stamp, BASE_FRAME, pose.position, pose.quaternion))
            add("camera/image_raw", step, image_message(stamp, "camera", image))
            add("keypoints", step, keypoints_message(stamp, "camera", keypoints))
            add("episode/tick", step, phase_message(PhaseState("post"), stamp))
    sequencer.flush()
    writer.close()
    return path
