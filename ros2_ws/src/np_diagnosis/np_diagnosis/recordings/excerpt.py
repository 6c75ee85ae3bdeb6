"""A part of each recording for a quick look: stretches of it, evenly spread, that are compared instead of
all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace

import numpy as np

from np_diagnosis.recordings.signals import Commands, Log

STRETCH = 6.0  # s, two blocks of the design
SHORT = 45.0  # s in all, below which nothing is left out


def excerpts(logs: Sequence[Log], most: float = SHORT) -> list[Log]:
    """Stretches of the logs, as logs of their own, of about `most` s in all; the logs where they are no
    longer."""
    total = sum(log.duration for log in logs)
    if total <= most:
        return list(logs)
    found = []
    for log in logs:
        count = max(2, round(log.duration / total * most / STRETCH))
        starts = np.linspace(0.0, log.duration - STRETCH, count)
        if count * STRETCH >= log.duration:
            found.append(log)
        else:
            found += [_cut(log, start, start + STRETCH) for start in starts]
    return found


def _cut(log: Log, begin: float, end: float) -> Log:
    """The rows of a log from begin to end, s since its first row; times begin at zero again."""
    first, last = np.searchsorted(log.time - log.time[0], [begin, end])
    rows, zero = slice(first, last), log.time[first]
    commands = log.commands
    if commands is not None:
        kept = (commands.rows >= first) & (commands.rows < last)
        parts = {f.name: getattr(commands, f.name)[kept] for f in fields(Commands) if f.name != "feedforward"}
        parts["rows"], parts["torque_time"] = parts["rows"] - first, parts["torque_time"] - zero
        commands = replace(commands, **parts)
    return replace(
        log,
        time=log.time[rows] - zero,
        position=log.position[rows],
        velocity=log.velocity[rows],
        torque=log.torque[rows],
        torque_time=log.torque_time[rows] - zero,
        commands=commands,
        motor=None if log.motor is None else log.motor[rows],
        phases=tuple((at - begin, state) for at, state in log.phases if begin <= at < end),
    )
