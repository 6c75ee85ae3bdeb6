"""The kinds of wrong conventions, as they come into recordings."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from sim2real.recordings.signals import Log
from sim2real.wiring.check import WiringRecording

from np_common.rotations import matrix_from_quaternion, quaternion_from_matrix, quaternion_multiply, yaw_quaternion
from np_control.kinematics import forward_kinematics
from np_description.camera import CAMERA

STREAMS = {
    "position": "position",
    "velocity": "velocity",
    "state": "position velocity",
    "effort": "torque",
    "target": "target target_velocity",
    "command": "commanded",
}
ORDERS = {  # number in the contract's order of each corner, by who numbers them so
    "opencv": (0, 4, 6, 2, 1, 5, 7, 3),
    "x fastest": (0, 4, 2, 6, 1, 5, 3, 7),
    "top first": (1, 5, 7, 3, 0, 4, 6, 2),
}
FLANGE_TO_HAND = yaw_quaternion(np.asarray(-np.pi / 4))
HAND_TO_TOOL = 0.1034  # m (Franka Emika, hand's data sheet)


@dataclass(frozen=True, eq=False)
class Subject:
    """A recording with a wrong convention, or none."""

    log: Log
    """Its joints."""
    streams: WiringRecording | None
    """All else; None for a recording of the arm alone."""


@dataclass(frozen=True)
class WiringFaultKind:
    """A kind of wrong convention."""

    name: str
    """In tables."""
    expected: str
    """`WiringFault.kind` that it is."""
    joints: tuple[int, ...]
    """Joints that it concerns, from 0; none where it concerns all."""
    source: str
    """Recording that it is put in: arm or episode."""
    apply: Callable[[Subject, np.random.Generator], Subject]
    """Puts it in."""


def _change(subject: Subject, names: str, function: Callable[[np.ndarray], np.ndarray]) -> Subject:
    log, c = subject.log, subject.log.commands
    measured, commanded = {}, {}
    for name in names.split():
        if name == "commanded":
            commanded["torque"] = function(c.torque)
        elif name.startswith("target"):
            commanded[name] = function(getattr(c, name))
        else:
            measured[name] = function(getattr(log, name))
    return replace(subject, log=replace(log, **measured, commands=replace(c, **commanded)))


def _swap(joint: int):
    order = np.arange(7)
    order[[joint, joint + 1]] = joint + 1, joint
    return lambda s, rng: _change(s, STREAMS[str(rng.choice(list(STREAMS)))], lambda v: v[:, order])


def _sign(joint: int):
    sign = np.where(np.arange(7) == joint, -1.0, 1.0)
    return lambda s, rng: _change(s, STREAMS[str(rng.choice(list(STREAMS)))], lambda v: v * sign)


def _degrees(s: Subject, rng: np.random.Generator) -> Subject:
    return _change(s, STREAMS[str(rng.choice(["position", "state", "target"]))], np.degrees)


def _delay(s: Subject, rng: np.random.Generator) -> Subject:
    late = int(rng.choice([-1, 1]))
    names = rng.choice(["position", "velocity", "position velocity torque", "torque", "commanded"])
    return _change(s, str(names), lambda v: np.concatenate([v[:1], v[:-1]] if late > 0 else [v[1:], v[-1:]]))


def _gains(s: Subject, rng: np.random.Generator) -> Subject:
    factor, c = float(rng.choice([0.25, 4.0])), s.log.commands
    c = replace(c, stiffness=factor * c.stiffness, damping=np.sqrt(factor) * c.damping)
    return replace(s, log=replace(s.log, commands=c))


def _poses(function) -> Callable[[Subject, np.random.Generator], Subject]:
    """Of position (n, 3) m and quaternion (n, 4) wxyz of target poses, and those of T_E measured then."""

    def apply(s: Subject, rng: np.random.Generator) -> Subject:
        stamps = (s.streams.pose_stamps - s.streams.headers["joint_states"][0]) / 1e9
        place, turn = forward_kinematics(s.log.position[np.searchsorted(s.log.time, stamps)])
        sent = s.streams.poses
        position, quaternion = function(sent[:, :3], sent[:, [6, 3, 4, 5]], place, turn, rng)
        poses = np.column_stack([position, quaternion[:, 1:], quaternion[:, :1]])
        return replace(s, streams=replace(s.streams, poses=poses))

    return apply


def _quaternion(s: Subject, rng: np.random.Generator) -> Subject:
    poses = s.streams.poses[:, [0, 1, 2, 6, 3, 4, 5]]
    return replace(s, streams=replace(s.streams, poses=poses))


def _frame(position, quaternion, place, turn, rng):
    rotation = matrix_from_quaternion(quaternion)
    which = rng.integers(4)
    if which < 2:  # of the hand, or of the flange
        ahead = position - HAND_TO_TOOL * rotation[:, :, 2]
        inverse = FLANGE_TO_HAND * [1, -1, -1, -1]
        return ahead, quaternion if which else quaternion_multiply(
            quaternion, np.broadcast_to(inverse, quaternion.shape)
        )
    if which == 2:  # in the tool's frame
        back = np.swapaxes(turn, 1, 2)
        return np.einsum("nij,nj->ni", back, position - place), quaternion_from_matrix(back @ rotation)
    quarter = yaw_quaternion(np.asarray(np.pi / 2 * rng.choice([1, 2, 3])))
    return position @ matrix_from_quaternion(quarter).T, quaternion_multiply(
        np.broadcast_to(quarter, quaternion.shape), quaternion
    )


def _scale(position, quaternion, place, turn, rng):
    return place + float(rng.choice([0.1, 0.5, 2.0, 10.0])) * (position - place), quaternion


def _picture(keypoints: np.ndarray, images: np.ndarray, turns: int, is_mirrored: bool):
    """A camera that is mounted, or read, in another way: images, and the keypoints that are found in them."""
    last = CAMERA.width - 1
    u, v, score = np.moveaxis(keypoints, -1, 0)
    if is_mirrored:
        u, images = last - u, images[:, :, ::-1]
    for _ in range(turns):
        u, v, images = v, last - u, np.rot90(images, axes=(1, 2))
    return np.stack([u, v, score], axis=-1), images


def _view(pick) -> Callable[[Subject, np.random.Generator], Subject]:
    def apply(s: Subject, rng: np.random.Generator) -> Subject:
        keypoints, images = _picture(s.streams.keypoints, s.streams.images, *pick(rng))
        has_images = bool(rng.integers(2))  # most recordings have keypoints alone
        return replace(s, streams=replace(s.streams, keypoints=keypoints, images=images if has_images else images[:0]))

    return apply


def _colours(s: Subject, rng: np.random.Generator) -> Subject:
    return replace(s, streams=replace(s.streams, images=s.streams.images[..., ::-1]))


def _corners(s: Subject, rng: np.random.Generator) -> Subject:
    is_cube = len(set(s.streams.domain.half_size)) == 1
    order = ORDERS[str(rng.choice([name for name in ORDERS if not (is_cube and name == "x fastest")]))]
    return replace(s, streams=replace(s.streams, keypoints=s.streams.keypoints[:, order], images=s.streams.images[:0]))


def _clock(s: Subject, rng: np.random.Generator) -> Subject:
    topic = str(rng.choice(["keypoints", "target_pose"]))
    offset, drift = (float(rng.choice([-40.0, -1.0, 1.0, 3600.0])), 0.0) if rng.integers(2) else (0.0, 2e-3)
    stamps = s.streams.headers[topic]
    moved = stamps + np.int64(1e9 * offset) + (drift * (stamps - stamps[0])).astype(np.int64)
    return replace(s, streams=replace(s.streams, headers={**s.streams.headers, topic: moved}))


KINDS = (
    *(WiringFaultKind(f"joints {j + 1} and {j + 2} exchanged", "swap", (j, j + 1), "arm", _swap(j)) for j in range(6)),
    *(WiringFaultKind(f"sign of joint {j + 1}", "sign", (j,), "arm", _sign(j)) for j in range(7)),
    WiringFaultKind("degrees", "degrees", (), "arm", _degrees),
    WiringFaultKind("quaternion w x y z", "quaternion", (), "episode", _quaternion),
    WiringFaultKind("frame of target poses", "frame", (), "episode", _poses(_frame)),
    WiringFaultKind("one sample late or early", "delay", (), "arm", _delay),
    WiringFaultKind("gains times 4", "gains", (), "arm", _gains),
    WiringFaultKind("action scale", "action_scale", (), "episode", _poses(_scale)),
    WiringFaultKind("BGR for RGB", "colours", (), "episode", _colours),
    WiringFaultKind("picture rotated", "image", (), "episode", _view(lambda rng: (int(rng.integers(1, 4)), False))),
    WiringFaultKind("picture mirrored", "image", (), "episode", _view(lambda rng: (2 * int(rng.integers(2)), True))),
    WiringFaultKind("corners in another order", "corners", (), "episode", _corners),
    WiringFaultKind("two clocks", "clock", (), "episode", _clock),
)
