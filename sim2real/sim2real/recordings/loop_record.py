"""What a bag holds on the timing of its control loop: stamps of the streams, and the diagnostics of the nodes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from np_description.control_rate import SECOND
from np_record.bag import BagError, Recording

EMPTY = np.zeros(0)


@dataclass(frozen=True, eq=False)
class NodeReports:
    """The d messages that one node published on `diagnostics`."""

    time: np.ndarray
    """(d,) s, increasing."""
    values: Mapping[str, np.ndarray]
    """(d,) by key, NaN where a message lacks the key, or its value is no number."""
    words: tuple[str, ...]
    """d texts: the message and all values that are no numbers."""

    def has(self, key: str) -> bool:
        """Whether any message has a number under this key."""
        return key in self.values

    def latest(self, key: str) -> np.ndarray:
        """(d,) the number under a key, as of the last message that had it; 0 before the first, or without any."""
        found = self.values.get(key)
        if found is None:
            return np.zeros(len(self.time))
        rows = np.maximum.accumulate(np.where(np.isfinite(found), np.arange(len(found)), -1))
        return np.where(rows < 0, 0.0, found[rows])

    def growth(self, key: str) -> np.ndarray:
        """(d,) by how much a count grew since the message before. A node that was started again counts from zero."""
        found = self.values.get(key)
        if found is None:
            return np.zeros(len(self.time))
        known = np.flatnonzero(np.isfinite(found))
        grown = np.zeros(len(found))
        if key.startswith("refused_"):  # appears with its first event
            known = np.union1d(known, [0])
        counted = np.nan_to_num(found[known])
        steps = np.diff(counted)
        grown[known[1:]] = np.where(steps < 0, counted[1:], steps)
        return grown


@dataclass(frozen=True, eq=False)
class LoopRecord:
    """Times of one recording, all s since its first joint state."""

    states: np.ndarray
    """(n,) stamps of `joint_states`, increasing."""
    commands: np.ndarray = field(default_factory=EMPTY.copy)
    """(m,) stamps of `effort_command`: those of the states that the controller answered."""
    targets: np.ndarray = field(default_factory=EMPTY.copy)
    """(p,) stamps of `target_pose`: those of the data that the policy acted on."""
    sent: np.ndarray = field(default_factory=EMPTY.copy)
    """(p,) when the gains of each target were published; none where gains and targets are not pairs."""
    nodes: Mapping[str, NodeReports] = field(default_factory=dict)
    """Diagnostics by the node's name without its namespace."""

    @property
    def is_lockstep(self) -> bool:
        """Whether time waited for the replies."""
        return any("mode: lockstep" in text for node in self.nodes.values() for text in node.words)

    def first_with(self, key: str) -> NodeReports | None:
        """The first node whose diagnostics have a number under this key."""
        return next((node for node in self.nodes.values() if node.has(key)), None)


def read_loop_record(recording: Recording, states: np.ndarray, commands: np.ndarray) -> LoopRecord:
    """Of an open bag, with the stamps (n,) of its joint states and (m,) of its commands, ns.

    Diagnostics and targets that cannot be dated or read are none: the arm is judged without them.
    """
    first = states[0]

    def seconds(name: str) -> np.ndarray:
        return (stamped[name].stamp - first) / SECOND if name in stamped else EMPTY

    try:
        has_diagnostics, has_targets = (recording.counts.get(name) for name in ("diagnostics", "target_pose"))
        diagnostics = [(m.stamp, m.decode()) for m in recording.messages("diagnostics")] if has_diagnostics else []
        stamped = recording.rows("target_pose", "target_gains") if has_targets else {}
    except BagError:
        diagnostics, stamped = [], {}
    targets, gains = seconds("target_pose"), seconds("target_gains")
    return LoopRecord(
        (states - first) / SECOND,
        (commands - first) / SECOND,
        targets,
        gains if len(gains) == len(targets) else EMPTY,
        collect_reports([((stamp - first) / SECOND, message.status) for stamp, message in diagnostics]),
    )


def collect_reports(messages: Sequence[tuple[float, Sequence]]) -> dict[str, NodeReports]:
    """Diagnostics by node, from (time s, list of DiagnosticStatus) in the order of time."""
    rows: dict[str, list[tuple[float, dict[str, float], str]]] = {}
    for time, statuses in messages:
        for status in statuses:
            numbers, texts = {}, [status.message]
            for pair in status.values:
                try:
                    numbers[pair.key] = float(pair.value)
                except ValueError:
                    texts.append(f"{pair.key}: {pair.value}")
            rows.setdefault(status.name.rpartition("/")[2], []).append((time, numbers, "\n".join(texts)))
    return {name: _reports(found) for name, found in rows.items()}


def _reports(rows: Sequence[tuple[float, dict[str, float], str]]) -> NodeReports:
    times, numbers, words = zip(*rows)
    keys = dict.fromkeys(key for one in numbers for key in one)
    values = {key: np.array([one.get(key, np.nan) for one in numbers]) for key in keys}
    return NodeReports(np.array(times), values, words)
