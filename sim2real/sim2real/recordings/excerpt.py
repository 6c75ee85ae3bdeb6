"""A part of each recording for a quick look: stretches of it, evenly spread, that are compared instead of all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace

import numpy as np

from sim2real.recordings.signals import Commands, Log
from sim2real.thresholds import THRESHOLDS

RECORDINGS = THRESHOLDS.recordings


def cut_excerpts(logs: Sequence[Log], most: float = RECORDINGS.short) -> list[Log]:
    """Stretches of the logs, as logs of their own, of about `most` s in all; the logs themselves if they are no longer."""
    total = sum(log.duration for log in logs)
    if total <= most:
        return list(logs)
    found = []
    for log in logs:
        count = max(2, round(log.duration / total * most / RECORDINGS.stretch))
        starts = np.linspace(0.0, log.duration - RECORDINGS.stretch, count)
        if count * RECORDINGS.stretch >= log.duration:
            found.append(log)
        else:
            found += [_cut_log(log, start, start + RECORDINGS.stretch) for start in starts]
    return found


def _cut_log(log: Log, begin: float, end: float) -> Log:
    """The rows of a log from begin to end, s since its first row; times begin at zero again."""
    first, last = np.searchsorted(log.time - log.time[0], [begin, end])
    rows, zero = slice(first, last), log.time[first]
    commands = log.commands
    if commands is not None:
        kept = (commands.rows >= first) & (commands.rows < last)
        parts = {
            f.name: getattr(commands, f.name)[kept]
            for f in fields(Commands)
            if not f.name.endswith(("feedforward", "law"))
        }
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
