"""The player: publishes what robot, camera and episode published in a recording, and compares what the nodes publish."""

from __future__ import annotations

from collections import deque

from np_record.bag import Message
from np_record.cdr import padding_filter
from np_record.nodes.recorder_node import find_message_class
from np_record.replay import ReplayComparison, ReplayScript, ReplayStep
from np_record.topics import BY_NAME
from np_ros import qos
from np_ros.client.supervised_client import SupervisedGraphClient
from np_ros.processes.supervisor import Supervisor

_EVENTS = ("gripper_command", "pre_contact_pose", "joint_trajectory", "approach/refusal")


class Player(SupervisedGraphClient):
    """Plays a script to the nodes of a supervisor and compares their replies.

    patience: s of wall time in which a reply must come.
    """

    def __init__(self, supervisor: Supervisor, script: ReplayScript, patience: float = 60.0):
        super().__init__(supervisor, "player")
        self._patience = patience
        self.comparison = ReplayComparison(script.live)
        self._publishers = {
            name: self._node.create_publisher(
                find_message_class(BY_NAME[name].type),
                name,
                qos.LATCHED if BY_NAME[name].latched else qos.LOCKSTEP,
            )
            for name in script.fed
        }
        self._received: dict[str, deque[bytes]] = {name: deque() for name in script.live}
        for name in script.live:
            self._node.create_subscription(
                find_message_class(BY_NAME[name].type),
                name,
                self._receiver(name),
                qos.EVENT if name in _EVENTS else qos.LOCKSTEP,
                raw=True,
            )

    def wait_until_ready(self, names: set[str], timeout: float = 120.0) -> None:
        """Wait until the nodes are up, and matched with each other and with the player, in both directions."""
        self._wait(
            lambda: self._links.are_complete(names),
            timeout,
            f"the nodes {', '.join(sorted(names))}, all matched",
        )
        for name in sorted(names):
            self._services.be_found(name, timeout)

    def play(self, step: ReplayStep) -> bool:
        """One step: publish, receive, compare. False if a reply is missing: later ones are not reliable."""
        for sent, awaited in ((step.first, step.answers), (step.then, step.final_answers)):
            for message in sent:
                self._publishers[message.topic.name].publish(message.data)
            if not self._receive(awaited):
                return False
        return True

    def finish(self, stamp: int) -> None:
        """Count what came and was not recorded."""
        for _ in range(20):
            self._spinner.spin_once(0.01)
        for name, received in self._received.items():
            while received:
                self.comparison.extra(name, stamp, received.popleft())

    def _receive(self, awaited: list[Message]) -> bool:
        for message in awaited:
            received = self._received[message.topic.name]
            try:
                self._wait(lambda: received, self._patience, message.topic.name)
            except TimeoutError:
                self.comparison.answer(message, None)
                return False
            self.comparison.answer(message, received.popleft())
        return True

    def _receiver(self, name: str):
        clean = padding_filter(BY_NAME[name].type)
        return lambda data: self._received[name].append(clean(data))
