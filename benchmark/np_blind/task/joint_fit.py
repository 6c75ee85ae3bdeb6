"""What fitting a fixed list comes to, on the same recordings: every number that was measured, taken as it is, and named where its interval is
beyond the nominal value. Nothing competes, nothing is a class, and nothing is ever unexplained."""

from __future__ import annotations

from dataclasses import dataclass

from sim2real.effects import CAMERA_EFFECTS, SCENE_EFFECTS
from sim2real.effects.patch import Patch, PatchEffect
from sim2real.task.contact_force.fit import NominalContact
from sim2real.task.diagnosis import TaskDiagnosis

FORCES = {"table": "table_friction", "mass": "object_mass", "finger": "gripper_friction"}


@dataclass(frozen=True)
class AtOnce:
    """patch: with all numbers; named: effects whose interval does not hold the nominal value."""

    patch: Patch
    named: list[str]


def at_once(found: TaskDiagnosis) -> AtOnce:
    """Of the numbers that the stages measured."""
    values: dict[str, dict[str, float]] = {}
    named = set()

    def put(effect: str, quantity: str, value: float, low: float, high: float) -> None:
        values.setdefault(effect, {})[quantity] = value
        if not low <= 0.0 <= high:
            named.add(effect)

    if found.forces and found.forces.measured:
        believed = NominalContact.of(found.recordings.tasks[0].domain)
        for number, effect in FORCES.items():
            if number in found.forces.measured:
                put(effect, "relative", *(v / getattr(believed, number) - 1 for v in found.forces.measured[number]))
    if found.surfaces and found.surfaces.comparison:
        height = found.surfaces.comparison.bounds["height"]
        put("table_height", "height", height.value, height.low, height.high)
    if found.latency and found.latency.late:
        put("camera_latency", "delay", found.latency.late.value, found.latency.late.low, found.latency.late.high)
    if found.hand_eye and found.hand_eye.comparison:
        for axis in "xy":
            off = found.hand_eye.comparison.bounds[axis]
            put("camera_extrinsics", axis, -off.value, -off.high, -off.low)
    records = {**SCENE_EFFECTS, **CAMERA_EFFECTS}
    if "camera_latency" in values:  # a picture does not come before it is taken
        values["camera_latency"]["delay"] = max(0.0, values["camera_latency"]["delay"])
    entries = (PatchEffect(effect, str(records[effect].target), given) for effect, given in values.items())
    return AtOnce(Patch(tuple(entries)), sorted(named))
