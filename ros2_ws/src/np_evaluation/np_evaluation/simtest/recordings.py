"""What a run's bags promise: every message that was sent while they were open, and answers that a replay gives again byte by byte."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from pathlib import Path
from random import Random

from np_evaluation.simtest.endpoints import Publisher
from np_evaluation.simtest.network import Network
from np_evaluation.simtest.node import SimulatedNode
from np_evaluation.simtest.process import Process, node_class
from np_evaluation.simtest.scheduler import SECOND, Disk, Locks, Scheduler, simulate_host
from np_record.bag import BagError, Message, Recording
from np_record.cdr import header_stamp, padding_filter
from np_record.nodes.recorder_node import find_message_class
from np_record.replay import ReplayComparison, ReplayScript
from np_record.topics import BY_NAME, TOPICS
from np_ros import qos
from np_ros.processes.graph import NodeSpec

BENIGN = {"delay", "loss", "freeze", "clock_jump", "push", "late_start", "pause"}
"""Faults after which the answering nodes still answer what they were sent: a recording replays."""
_FILTERS = {topic.name: padding_filter(topic.type) for topic in TOPICS}


class SentMessages:
    """What was sent to the recorder since a bag was opened."""

    def __init__(self) -> None:
        self._messages: list[tuple[str, bytes]] = []
        self._bag, self.is_open = "", False

    def open(self, bag: str) -> None:
        """A bag has been opened."""
        self._messages, self._bag, self.is_open = [], bag, True

    def note(self, publisher: Publisher, data: bytes) -> None:
        """A message is on its way to everybody that the publisher has found."""
        name = publisher.topic_name.lstrip("/")
        if self.is_open and any(link.subscription.process.spec.name == "recorder" for link in publisher.links):
            self._messages.append((name, data))

    def missing(self, bag: str) -> str:
        """The first message that a bag should have and has not, "" where it has all, or where nobody heard of its beginning; of before its
        goal none is promised."""
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


def read_cut_off(bag: Path, random: Random) -> str:
    """Cut the bag's file at a random place and read it: "" where that is refused, or gives messages of the whole bag in their order."""
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
        else f"of a bag cut off {len(read)} messages were read that it does not begin with"
    )


class _Player:
    """Stands where robot, camera and episode stood (np_record.nodes.player_node, without processes)."""

    def __init__(self, scheduler: Scheduler, script: ReplayScript, process: Process):
        self._scheduler, self.comparison = scheduler, ReplayComparison(script.live)
        self._said = {
            name: process.node.create_publisher(
                find_message_class(BY_NAME[name].type), name, qos.LATCHED if BY_NAME[name].latched else qos.LOCKSTEP
            )
            for name in script.fed
        }
        self._heard: dict[str, deque[bytes]] = {name: deque() for name in script.live}
        for name in script.live:
            process.node.create_subscription(
                find_message_class(BY_NAME[name].type), name, self._receiver(name), qos.RECORDER, raw=True
            )

    def _receiver(self, name: str) -> Callable[[bytes], None]:
        return lambda data: self._heard[name].append(_FILTERS[name](data))

    def play(self, script: ReplayScript) -> ReplayComparison:
        """Every step, until an answer stays away."""
        for step in script.steps():
            for said, awaited in ((step.first, step.answers), (step.then, step.final_answers)):
                for message in said:
                    self._said[message.topic.name].publish(message.data)
                if not all(self._hear(message) for message in awaited):
                    return self.comparison
        return self.comparison

    def _hear(self, message: Message) -> bool:
        heard, end = self._heard[message.topic.name], self._scheduler.now + 10 * SECOND
        while not heard and self._scheduler.now < end:
            self._scheduler.run_until(self._scheduler.now + SECOND // 5000)
        self.comparison.answer(message, heard.popleft() if heard else None)
        return self.comparison.first is None


class _Silent(SimulatedNode):
    """A node that does nothing of its own."""

    def __init__(self):
        super().__init__("player")


def replay(bag: str, parameters: Mapping[str, Mapping]) -> str:
    """Play a bag to the nodes that answered in it; the first difference, "" where there is none."""
    scheduler = Scheduler(0)
    with Recording(bag) as recording:
        return _replay(ReplayScript(recording), scheduler, parameters)


def _replay(script: ReplayScript, scheduler: Scheduler, parameters: Mapping[str, Mapping]) -> str:
    classes = {spec.name: node_class(spec) for spec in script.specs}
    with simulate_host(scheduler, Locks(), Disk()):
        wires = Network(scheduler)
        processes: dict[str, Process] = {}
        for spec in script.specs:
            given = NodeSpec(
                spec.package, spec.executable, spec.name, {**spec.parameters, **parameters.get(spec.name, {})}
            )
            processes[spec.name] = Process(wires, given, classes[spec.name], lambda text: None, lambda: [*processes])
        player = Process(wires, NodeSpec("", "player"), _Silent, lambda text: None, lambda: [*processes])
        stand_in = _Player(scheduler, script, player)
        scheduler.run_until(scheduler.now + SECOND)  # until all have found each other
        first = stand_in.play(script).first
    return "" if first is None else f"{first.topic} at {first.stamp} ns: {first.what}"
