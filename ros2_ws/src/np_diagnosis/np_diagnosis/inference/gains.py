"""Torque constants of motors, settled together with the effects that spoil a first estimate.

A payload that the nominal arm does not know loads every joint: constants estimated without it take up part of it. Where the
constants of a recording are estimated (`recordings.current`), every joint has a nuisance that says by what share its constant
is too large. It is read off the best model of a short search, taken out of the torque, and asked again.
"""

from __future__ import annotations

import numpy as np

from np_diagnosis.arm.model import Arm
from np_diagnosis.inference.context import make_context
from np_diagnosis.inference.design import make_design
from np_diagnosis.inference.nuisances import TORQUE_CONSTANT
from np_diagnosis.inference.search import Search, fits_of
from np_diagnosis.recordings.current import as_torque
from np_diagnosis.recordings.signals import Log
from np_diagnosis.thresholds import THRESHOLDS

CURRENT = THRESHOLDS.current


def settled(logs: list[Log], arm: Arm) -> list[Log]:
    """The logs with torques by constants that go with the effects found; as they are where their torque was measured."""
    if all(log.per_ampere is None for log in logs):
        return logs
    for _ in range(CURRENT.rounds):
        search = Search(make_design(make_context(logs, arm)))
        excess = _excess(search, len(arm))
        logs = [log if log.per_ampere is None else as_torque(log, log.per_ampere / (1 + excess)) for log in logs]
        if np.abs(excess).max() < CURRENT.settled:
            break
    return logs


def _excess(search: Search, joints: int) -> np.ndarray:
    """Share (k,) by which each joint's constant is too large, with the best effects that a short search finds."""
    found = np.zeros(joints)
    for joint, (ids, fit) in fits_of(search, search.run(1).members).items():
        (at,) = (n for n, i in enumerate(ids) if i in search.design.nuisances[joint] and _is_constant(search, i))
        found[joint] = fit.parameters[:, at].mean()
    return found


def _is_constant(search: Search, parameter: int) -> bool:
    return search.design.parameters[parameter].name == TORQUE_CONSTANT
