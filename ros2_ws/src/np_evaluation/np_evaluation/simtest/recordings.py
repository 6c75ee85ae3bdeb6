"""Checks the bags of a run: they hold every message sent while they were open, and a replay reproduces them byte by byte."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from pathlib import Path
from random import Random

from np_evaluation.simtest.endpoints import Publisher
from np_evaluation.simtest.network import Network
from np_evaluation.simtest.node import SimulatedNode
from np_evaluation.simtest.process import Process, find_node_class
from np_evaluation.simtest.scheduler import SECOND, Disk, Locks, Scheduler, simulate_host
from np_record.bag import BagError, Message, Recording
from np_record.cdr import header_stamp, padding_filter
from np_record.nodes.recorder_node import find_message_class
from np_record.replay import ReplayComparison, ReplayScript
from np_record.topics import BY_NAME, TOPICS
from np_ros import qos
from np_ros.processes.graph import NodeSpec

BENIGN = {"delay", "loss", "freeze", "clock_jump", "push", "late_start", "pause"}
"""Faults that change no reply to a given input: a recording with these alone must replay."""
_FILTERS = {topic.name: padding_filter(topic.type) for topic in TOPICS}


class SentMessages:
    """The messages sent to the recorder since a bag was opened."""

    def __init__(self) -> None:
        self._messages: list[tuple[str, bytes]] = []
        self._bag, self.is_open = "", False

    def open(self, bag: str) -> None:
        """Start a new list for the bag of this name."""
        self._messages, self._bag, self.is_open = [], bag, True

    def on_sent(self, publisher: Publisher, data: bytes) -> None:
        """Store a message if its publisher has matched the recorder."""
        name = publisher.topic_name.lstrip("/")
        if self.is_open and any(link.subscription.process.spec.name == "recorder" for link in publisher.links):
            self._messages.append((name, data))

    def find_missing(self, bag: str) -> str:
        """Describe the first message that the bag lacks, "" if it lacks none or its start was not confirmed; messages before the goal may
        be missing."""
        if bag != self._bag:
            return ""
        with Recording(bag) as recording:
            kept = {(message.topic.name, message.data) for message in recording.messages()}
            begin = recording.start
        is_begun = False
        for number, (name, sent) in enumerate(self._messages):
            is_begun |= name == "goal_pose"
            topic, data = BY_NAME[name], _FILTERS[name](sent)
            is_due = header_stamp(data) >= begin if topic.stamped else is_begun and topic.name != "diagnostics"
            if is_begun and is_due and (name, data) not in kept:
                return f"{name}, number {number} of {len(self._messages)} that were sent"
        return ""


def check_truncated(bag: Path, random: Random) -> str:
    """Truncate the bag's file at random and read it: "" if reading fails or gives the first messages in order, otherwise what is wrong."""
    file = next(bag.glob("*.mcap"))
    with Recording(bag) as recording:
        whole = [message.data for message in recording.messages()]
    content = file.read_bytes()
    file.write_bytes(content[: random.randrange(len(content))])
    try:
        with Recording(bag) as recording:
            read = [message.data for message in recording.messages()]
    except BagError:
        return ""
    finally:
        file.write_bytes(content)
    return (
        ""
        if read == whole[: len(read)]
        else f"{len(read)} messages read from a truncated bag are not the first of the whole bag"
    )


class _Player:
    """Replaces robot, camera and episode in a replay, as np_record.nodes.player_node does with processes."""

    def __init__(self, scheduler: Scheduler, script: ReplayScript, process: Process):
        self._scheduler, self.comparison = scheduler, ReplayComparison(script.live)
        self._publishers = {
            name: process.node.create_publisher(
                find_message_class(BY_NAME[name].type), name, qos.LATCHED if BY_NAME[name].latched else qos.LOCKSTEP
            )
            for name in script.fed
        }
        self._received: dict[str, deque[bytes]] = {name: deque() for name in script.live}
        for name in script.live:
            process.node.create_subscription(
                find_message_class(BY_NAME[name].type), name, self._make_callback(name), qos.RECORDER, raw=True
            )

    def _make_callback(self, name: str) -> Callable[[bytes], None]:
        return lambda data: self._received[name].append(_FILTERS[name](data))

    def play(self, script: ReplayScript) -> ReplayComparison:
        """Play all steps until a reply is missing or differs."""
        for step in script.steps():
            for sent, awaited in ((step.first, step.answers), (step.then, step.final_answers)):
                for message in sent:
                    self._publishers[message.topic.name].publish(message.data)
                if not all(self._compare(message) for message in awaited):
                    return self.comparison
        return self.comparison

    def _compare(self, message: Message) -> bool:
        received, end = self._received[message.topic.name], self._scheduler.now + 10 * SECOND
        while not received and self._scheduler.now < end:
            self._scheduler.run_until(self._scheduler.now + SECOND // 5000)
        self.comparison.answer(message, received.popleft() if received else None)
        return self.comparison.first is None


class _PlayerNode(SimulatedNode):
    """A node without timers or services."""

    def __init__(self):
        super().__init__("player")


def replay(bag: str, parameters: Mapping[str, Mapping]) -> str:
    """Replay a bag to the nodes whose replies it holds; returns the first difference, "" if there is none."""
    scheduler = Scheduler(0)
    with Recording(bag) as recording:
        return _replay(ReplayScript(recording), scheduler, parameters)


def _replay(script: ReplayScript, scheduler: Scheduler, parameters: Mapping[str, Mapping]) -> str:
    classes = {spec.name: find_node_class(spec) for spec in script.specs}
    with simulate_host(scheduler, Locks(), Disk()):
        network = Network(scheduler)
        processes: dict[str, Process] = {}
        for spec in script.specs:
            given = NodeSpec(
                spec.package, spec.executable, spec.name, {**spec.parameters, **parameters.get(spec.name, {})}
            )
            processes[spec.name] = Process(network, given, classes[spec.name], lambda text: None, lambda: [*processes])
        player = Process(network, NodeSpec("", "player"), _PlayerNode, lambda text: None, lambda: [*processes])
        peer = _Player(scheduler, script, player)
        scheduler.run_until(scheduler.now + SECOND)  # discovery
        first = peer.play(script).first
    return "" if first is None else f"{first.topic} at {first.stamp} ns: {first.what}"
