"""Stands between the graph and a backend with other names of its joints, in another order: `joint_states` and
`applied_command` come with its names and go on with ours, `effort_command` the other way.

The backend's own topics are under `arm/`: start it with `-r joint_states:=arm/joint_states` and so on.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from rclpy.node import Node
from rclpy.publisher import Publisher
from sensor_msgs.msg import JointState

from np_description.message_arrays import BadMessage, joint_state_arrays, stamp_nanoseconds
from np_description.panda import JOINT_NAMES, STATE_NAMES
from np_ros import qos
from np_ros.messages import joint_state_message
from np_ros.node import Diagnostics, declare_mode, parameter, run


class JointNameMap:
    """The backend's names of the joints.

    text: its nine names in our order (seven joints, two fingers), by commas; one word alone is the prefix that it has in
    place of `panda`. Raises ValueError for another number of names, or one that comes twice.
    """

    def __init__(self, text: str):
        given = [name.strip() for name in text.split(",")]
        if len(given) == 1 and given[0]:
            given = [name.replace("panda", given[0], 1) for name in STATE_NAMES]
        if len(set(given)) != len(STATE_NAMES) or "" in given:
            raise ValueError(
                f"parameter names: expected a prefix, or {len(STATE_NAMES)} different names by commas, got {text!r}"
            )
        self.theirs = tuple(given)

    def to_ours(self, message: JointState, names: Sequence[str]) -> JointState:
        """A message of the backend with our `names` in our order: position, velocity and effort of each go with its name.

        Raises BadMessage where other joints are named, or an array has not one finite number for each.
        """
        theirs = self.theirs[: len(names)]
        if sorted(message.name) != sorted(theirs):
            raise BadMessage(
                "names", f"JointState.name: expected {list(theirs)} in any order, got {list(message.name)}"
            )
        order = [message.name.index(name) for name in theirs]
        values = (array[order] for array in joint_state_arrays(message, message.name))
        return joint_state_message(stamp_nanoseconds(message.header.stamp), names, *values)

    def to_theirs(self, message: JointState) -> JointState:
        """A command with the backend's names, in our order; what has other names than ours goes on as it is, for the backend to
        refuse."""
        if tuple(message.name) == JOINT_NAMES:
            message.name = list(self.theirs[: len(JOINT_NAMES)])
        return message


class JointNames(Node):
    """Hands three streams on under other names of the joints."""

    def __init__(self):
        super().__init__("joint_names")
        given = parameter(self, "names", "fr3", "The backend's prefix in place of panda, or its nine names by commas.")
        lockstep = declare_mode(self, "realtime", "As the backend's.") == "lockstep"
        self._names = JointNameMap(given)
        self._diagnostics = Diagnostics(self)
        sent, heard = qos.publisher(lockstep), qos.subscriber(lockstep)
        for topic, names in (("joint_states", STATE_NAMES), ("applied_command", JOINT_NAMES)):
            onward = partial(self._on_state, self.create_publisher(JointState, topic, sent), names)
            self.create_subscription(JointState, f"arm/{topic}", onward, heard)
        self._commands = self.create_publisher(JointState, "arm/effort_command", sent)
        self.create_subscription(JointState, "effort_command", self._on_command, heard)

    def _on_state(self, onward: Publisher, names: Sequence[str], message: JointState) -> None:
        try:
            onward.publish(self._names.to_ours(message, names))
        except BadMessage as error:
            self._diagnostics.refuse(error.kind, error)

    def _on_command(self, message: JointState) -> None:
        self._commands.publish(self._names.to_theirs(message))


def main(args=None):
    """Run the node until SIGINT or SIGTERM."""
    return run(JointNames, args)


if __name__ == "__main__":
    raise SystemExit(main())
