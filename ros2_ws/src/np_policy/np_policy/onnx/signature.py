"""Names, shapes and units of what goes into a policy's graph and comes out: kept in the file's metadata as JSON."""

from __future__ import annotations

from dataclasses import dataclass

from np_policy.contract import POST_CONTACT, PRE_CONTACT

SIGNATURE, BOX, SOURCE = "signature", "half_size", "weights_sha256"  # keys of the metadata


@dataclass(frozen=True)
class Signature:
    """inputs, outputs: name to shape without the leading axis of samples, and unit; all float64."""

    inputs: dict[str, tuple[tuple[int, ...], str]]
    outputs: dict[str, tuple[tuple[int, ...], str]]


_PIXELS = (8, 2), "u, v px of the corners of the object's box; hidden ones have to be filled in before"
_GOAL = (8, 2), "u, v px of the same corners at the goal"
_POSITION = (3,), "m, of panda_tcp in panda_link0"
_ROTATION = (3, 3), "rotation matrix, panda_tcp to panda_link0"

SIGNATURES = {
    PRE_CONTACT: Signature(
        {"keypoints": _PIXELS, "goal_keypoints": _GOAL},
        {
            "position": _POSITION,
            "rotation": _ROTATION,
            "opening": ((), "m, of each finger"),
            "hand_pose": ((10,), "the network's output, see np_policy.hand_pose"),
        },
    ),
    POST_CONTACT: Signature(
        {
            "q": ((9,), "7 joints rad, 2 fingers m"),
            "dq": ((9,), "7 joints rad/s, 2 fingers m/s"),
            "keypoints": _PIXELS,
            "goal_keypoints": _GOAL,
            "last_action": ((20,), "the last output `action`; zeros at the start of an episode"),
        },
        {
            "position": _POSITION,
            "rotation": _ROTATION,
            "stiffness": ((7,), "Nm/rad"),
            "damping_ratio": ((7,), "rho; damping in Nms/rad is rho sqrt(stiffness)"),
            "action": ((20,), "the network's output, see np_policy.action"),
        },
    ),
}
NETWORK_OUTPUT = {PRE_CONTACT: "hand_pose", POST_CONTACT: "action"}
