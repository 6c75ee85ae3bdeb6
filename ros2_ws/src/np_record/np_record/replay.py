"""Replay of a lockstep recording: which messages are fed, which must come back, and where they differ. No
ROS.

Messages of robot, camera and episode are fed; those of detector, policies, planner and controller are compared,
byte by byte.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from np_description.phases import IDLE, PRE
from np_record.bag import BagError, Message, Recording
from np_record.cdr import deserialize
from np_record.recorded_phases import read_phase
from np_record.topics import BY_NAME
from np_ros.processes.policy_path import policy_path_nodes

BEFORE_TICK = ("keypoints", "gripper_command", "pre_contact_pose", "joint_trajectory", "approach/refusal")
AFTER_TICK = ("target_gains", "target_pose", "effort_command")
_DEFAULTS = {
    "domain": "card",
    "object": "default",
    "calibration": "",
    "weights": "",
    "seed": "0",
}
"""Launch arguments that are missing in an older recording: their values then, whatever the defaults of the launch are now."""
REQUIRED = ("joint_states", "goal_keypoints", "episode/phase", "episode/tick", "effort_command")


@dataclass
class ReplayStep:
    """The messages of one stamp."""

    stamp: int
    """ns."""
    first: list[Message] = field(default_factory=list)
    """Published first."""
    answers: list[Message] = field(default_factory=list)
    """Expected in reply."""
    then: list[Message] = field(default_factory=list)
    """Published after these replies."""
    final_answers: list[Message] = field(default_factory=list)
    """Expected in reply to those."""


@dataclass(frozen=True)
class Difference:
    """The first message that differs."""

    topic: str
    """Its topic."""
    index: int
    """Its number on the topic."""
    stamp: int
    """ns."""
    what: str
    """What was expected, and what came."""


class ReplayScript:
    """A recording as steps. `live`: topics that nodes publish in replay; `specs`: those nodes, as they were run.

    Raises BagError for a recording that was not made in lockstep or lacks what is needed.
    """

    def __init__(self, recording: Recording, weights: str = ""):
        mode = recording.information.get("mode")
        if mode != "lockstep":
            raise BagError(
                f"bag {recording.path}: expected a recording in lockstep (run_info of the recorder), got mode {mode!r}"
            )
        self._recording = recording
        self.from_camera = recording.counts.get("camera/image_raw", 0) > 0
        self.live = (*BEFORE_TICK, *AFTER_TICK) if self.from_camera else (*BEFORE_TICK[1:], *AFTER_TICK)
        nodes = policy_path_nodes({**_DEFAULTS, **recording.information, **({"weights": weights} if weights else {})})
        if not self.from_camera:
            del nodes["keypoint_detector"]
        self.specs = list(nodes.values())
        self.fed = [
            "joint_states",
            "goal_keypoints",
            "episode/phase",
            "episode/tick",
            *(["camera/image_raw"] if self.from_camera else ["keypoints"]),
        ]

    @property
    def length(self) -> int:
        """Number of steps."""
        return self._recording.counts["joint_states"]

    def steps(self) -> Iterator[ReplayStep]:
        """The steps in the order of their time. Raises BagError where the recording cannot be read."""
        step = None
        for message in self._recording.messages(*self.fed, *self.live):
            if step is None or message.stamp != step.stamp:
                if step is not None:
                    yield step
                step = ReplayStep(message.stamp)
            self._part(step, message).append(message)
        if step is not None:
            yield step

    def _part(self, step: ReplayStep, message: Message) -> list[Message]:
        name = message.topic.name
        if name in self.live:
            return step.answers if name in BEFORE_TICK else step.final_answers
        # The phases after `pre` follow the plan; so does the tick.
        is_later = name == "episode/tick"
        if name == "episode/phase":
            is_later = read_phase(f"bag {self._recording.path}", message).phase not in (IDLE, PRE)
        return step.then if is_later else step.first


class ReplayComparison:
    """Counts what came back against what was recorded.

    expected, received, identical: messages by topic; first: the first difference, or None.
    """

    def __init__(self, live: tuple[str, ...]):
        self.expected = dict.fromkeys(live, 0)
        self.received = dict.fromkeys(live, 0)
        self.identical = dict.fromkeys(live, 0)
        self.first: Difference | None = None

    @property
    def is_identical(self) -> bool:
        """Whether as many messages came as were recorded, all of them equal."""
        return self.expected == self.received == self.identical

    def answer(self, expected: Message, got: bytes | None) -> None:
        """Compare a recorded reply with the serialized message that came for it, None where none did."""
        name = expected.topic.name
        index = self.expected[name]
        self.expected[name] += 1
        self.received[name] += got is not None
        self.identical[name] += got == expected.data
        if got != expected.data and self.first is None:
            what = (
                "expected a message, none came"
                if got is None
                else describe_difference(expected.topic.type, expected.data, got)
            )
            self.first = Difference(name, index, expected.stamp, what)

    def extra(self, name: str, stamp: int, got: bytes) -> None:
        """A message that came although none was recorded."""
        self.received[name] += 1
        if self.first is None:
            decoded = deserialize(got, BY_NAME[name].type)
            self.first = Difference(name, self.expected[name], stamp, f"expected no message, got {decoded}"[:300])


def describe_difference(message_type: str, expected: bytes, got: bytes) -> str:
    """The first field that differs between two serialized messages, with both values."""
    try:
        pair = [deserialize(data, message_type) for data in (expected, got)]
    except Exception as error:  # whatever broken bytes lead to
        return f"expected a readable {message_type}, got one that is not: {error}"
    return _first_difference(*pair, "") or "expected the same bytes, got others for equal fields"


def _first_difference(a, b, path: str) -> str:
    if isinstance(a, np.ndarray):
        if a.shape != b.shape:
            return f"{path}: expected {a.size} numbers, got {b.size}"
        where = np.flatnonzero(~((a == b) | (np.not_equal(a, a) & np.not_equal(b, b))))
        return f"{path}[{where[0]}]: expected {a[where[0]]!r}, got {b[where[0]]!r}" if where.size else ""
    if isinstance(a, list):
        if len(a) != len(b):
            return f"{path}: expected {len(a)} entries, got {len(b)}"
        return next(
            (text for i, (x, y) in enumerate(zip(a, b)) if (text := _first_difference(x, y, f"{path}[{i}]"))),
            "",
        )
    names = getattr(a, "__dataclass_fields__", None)
    if names:
        return next(
            (
                text
                for name in names
                if name != "__msgtype__"
                and (text := _first_difference(getattr(a, name), getattr(b, name), f"{path}.{name}".lstrip(".")))
            ),
            "",
        )
    return "" if a == b or (a != a and b != b) else f"{path}: expected {a!r}, got {b!r}"
