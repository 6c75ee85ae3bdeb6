"""The joints to draw, of whatever is published on `joint_states`."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np

from np_description.message_arrays import BadMessage, check_finite, check_shape, stamp_nanoseconds
from np_description.panda import JOINT_NAMES, STATE_NAMES

_KEPT = 16  # messages: as many publishers on the topic may take turns


class ArmNotNamed(BadMessage):
    """None of the newest messages has all joints of the arm."""


class ShownJoints:
    """Arm and fingers in the newest JointStates, which may name other joints too, in any order, or arm and gripper in turn.

    What is added is decoded when it is read: of 500 messages a second viewers show twenty.
    """

    def __init__(self, decode: Callable[[Any], Any]):
        self._decode, self._newest = decode, deque(maxlen=_KEPT)

    def __bool__(self) -> bool:
        return bool(self._newest)

    def add(self, message: Any) -> None:
        """Add the newest message, as `decode` takes it."""
        self._newest.append(message)

    def read(self) -> tuple[int, np.ndarray]:
        """(stamp ns of the arm, positions (9,) rad and m in the order of STATE_NAMES); fingers without a position are closed.

        Raises ArmNotNamed, and BadMessage for a message that names a joint of ours and cannot be read.
        """
        found: dict[str, float] = {}
        stamp, named = 0, {}
        for data in reversed([*self._newest]):
            message = self._decode(data)
            names = list(message.name)
            named |= dict.fromkeys(names)
            ours = [name for name in names if name in STATE_NAMES]
            if not ours:
                continue
            if len(set(ours)) < len(ours):
                raise BadMessage("names", f"JointState.name: expected each joint once, got {names}")
            values = dict(zip(names, check_shape(message.position, (len(names),), "JointState.position").tolist()))
            if not found.keys() & set(JOINT_NAMES):
                stamp = stamp_nanoseconds(message.header.stamp)
            found = {name: values[name] for name in ours} | found
            if len(found) == len(STATE_NAMES):
                break
        missing = [name for name in JOINT_NAMES if name not in found]
        if missing:
            raise ArmNotNamed("names", f"JointState.name: expected {', '.join(missing)} too, got {', '.join(named)}")
        positions = np.array([found.get(name, 0.0) for name in STATE_NAMES])
        check_finite(positions[: len(JOINT_NAMES)], "JointState.position")
        return stamp, np.nan_to_num(positions, posinf=0.0, neginf=0.0)
