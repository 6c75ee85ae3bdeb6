"""Which convention of the joints' signals is wrong: exchanged joints, signs, degrees, gains, weight in the effort.

Every candidate is undone and its relations are compared with those of the recording as it is: a right one makes them all hold.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from sim2real.thresholds import THRESHOLDS
from sim2real.wiring.fault import WiringFault
from sim2real.wiring.joint_relations import JointRelations
from sim2real.wiring.joint_signals import COMMANDED, MEASURED, JointSignals

WIRING = THRESHOLDS.wiring
STREAMS = {
    "position": ("position",),
    "velocity": ("velocity",),
    "position and velocity": ("position", "velocity"),
    "effort": ("effort",),
    "joint_states": MEASURED,
    "target": ("target", "target_velocity"),
    "commanded effort": ("command",),
    "effort_command": COMMANDED,
    "everything": (*MEASURED, *COMMANDED),
}
TOPICS = {
    "position": ("joint_states", "position"),
    "velocity": ("joint_states", "velocity"),
    "position and velocity": ("joint_states", "position and velocity"),
    "effort": ("joint_states", "effort"),
    "joint_states": ("joint_states", "position, velocity and effort"),
    "target": ("effort_command", "joint target"),
    "commanded effort": ("effort_command", "effort"),
    "effort_command": ("effort_command", "joint target and effort"),
    "everything": ("joint_states", "measured and commanded positions, velocities and efforts"),
    "target_gains": ("target_gains", ""),
}
"""By stream, its topic and the part of its messages."""
GAINS = tuple(float(f) for f in np.geomspace(1 / 16, 16, 33) if abs(np.log2(f)) > 0.9)
"""Factors of recorded gains that are tried: what is nearer to 1 is a gain error of the arm, not of a convention."""
IN_DEGREES = ("position", "velocity", "position and velocity", "target", "everything")


@dataclass(frozen=True)
class WrongConvention:
    """A wrong convention."""

    kind: str
    """swap, sign, degrees, gains or gravity."""
    stream: str
    """Of STREAMS, or target_gains."""
    joints: tuple[int, ...]
    """Numbers of the joints that it concerns, from 0."""
    undo: Callable[[JointSignals], JointSignals]
    """The signals with the right convention."""
    factor: float = 1.0
    """Of gains: recorded ones over those in force."""


def candidates(joints: int) -> Iterator[WrongConvention]:
    """All for an arm of so many joints."""
    every = tuple(range(joints))
    for stream, names in STREAMS.items():
        for j in range(joints - 1):
            order = [*range(j), j + 1, j, *range(j + 2, joints)]
            yield WrongConvention(
                "swap", stream, (j, j + 1), lambda s, n=names, o=order: s.change(n, lambda v: v[:, o])
            )
        for j in range(joints):
            sign = np.where(np.arange(joints) == j, -1.0, 1.0)
            yield WrongConvention("sign", stream, (j,), lambda s, n=names, x=sign: s.change(n, lambda v: v * x))
    for stream in IN_DEGREES:
        names = tuple(n for n in STREAMS[stream] if n not in ("effort", "command"))
        yield WrongConvention("degrees", stream, every, lambda s, n=names: s.change(n, np.radians))
    for factor in GAINS:
        yield WrongConvention("gains", "target_gains", every, lambda s, f=factor: s.scale_gains(1 / f), factor)


def find_joint_fault(
    signals: JointSignals, relations: JointRelations, names: Sequence[str], is_current: bool = False
) -> WiringFault | None:
    """The convention whose correction makes the relations of all joints hold best, where it does so clearly. names: of the joints;
    is_current: efforts are motor currents.

    What a hand that touches something does to the effort is no convention: `dynamics` counts alone only where it then holds.
    """
    before = relations.contradictions(signals)
    total = sum(before.values())
    found, best = None, WIRING.gain
    weight = relations.weight(signals.position)
    other_weight = WrongConvention(
        "gravity",
        "effort",
        tuple(range(len(names))),
        lambda s: s.change(
            ("effort",), lambda effort: effort - weight if relations.without_gravity else effort + weight
        ),
    )
    # A current is no torque, from which a weight could be taken.
    for one in (*candidates(len(names)), *([] if is_current else [other_weight])):
        if one.stream != "everything" and total[list(one.joints)].sum() < WIRING.gain:
            continue  # nothing that it could correct
        if signals.command is None and set(STREAMS.get(one.stream, COMMANDED)) <= set(COMMANDED):
            continue
        after = relations.contradictions(one.undo(signals))
        gain = float((total - sum(after.values())).sum())
        by_dynamics = float((before["dynamics"] - after["dynamics"]).sum())
        is_known = gain - by_dynamics > WIRING.gain or after["dynamics"].mean() < WIRING.free_motion
        if gain > best and is_known:
            found, best = one, gain
    return None if found is None else _describe(found, names, relations.without_gravity)


def _describe(one: WrongConvention, names: Sequence[str], without_gravity: bool) -> WiringFault:
    joints = tuple(names[j] for j in one.joints)
    topic, part = TOPICS[one.stream]
    stream = f"{part} of {topic}" if part else topic
    if one.kind == "swap":
        text = f"The {stream} has {joints[0]} and {joints[1]} exchanged"
        remedy = f"Exchange columns {one.joints[0] + 1} and {one.joints[1] + 1} of the {stream}, or sort by name"
    elif one.kind == "sign":
        text = f"The {stream} has the sign of {joints[0]} reversed"
        remedy = f"Negate column {one.joints[0] + 1} of the {stream}"
    elif one.kind == "degrees":
        text, remedy, joints = f"The {stream} is in degrees", f"Multiply the {stream} by pi / 180", ()
    elif one.kind == "gravity":
        has, change = ("contains", "Subtract it") if without_gravity else ("lacks", "Add it")
        text, remedy, joints = (
            f"The {stream} {has} the torque that holds the arm's weight",
            f"{change} at each position",
            (),
        )
    else:
        text = f"The recorded stiffness is {one.factor:.3g} times what the controller uses"
        remedy, joints = f"Divide stiffness in target_gains by {one.factor:.3g}, or give it to the controller", ()
    return WiringFault(one.kind, topic, f"{text}.", f"{remedy}.", joints)
