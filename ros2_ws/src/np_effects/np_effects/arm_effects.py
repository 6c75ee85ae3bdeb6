"""What a patch does to commands, joints and measurements, stepped with the physics: the hooks of its records, composed.

What is a number of the rigid-body model is not here (`Patch.panda`). Effects of the controller, and of the motor's side of a
gear, are no simulated arm's to carry: `ignored` names them.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from np_effects.behaviour import Values
from np_effects.patch import Patch
from np_effects.record import EffectRecord
from np_effects.registry import RECORDS
from np_effects.weight import Hold, LeftOver, Weight


class ArmEffects:
    """The effects of one simulated arm, or of S side by side.

    patch: one, and every array below is (7,); or a sequence of S, and they are (S, 7). period: s of a control period, in
    which `drive`, `extra` and `sense` are called once each. seed: of lost packets, the same ones in all arms. begin: s for
    which the arms had been moving, a number or (S,).
    """

    def __init__(self, patch: Patch | Sequence[Patch], period: float, seed: int = 0, begin: float | np.ndarray = 0.0):
        patches = (patch,) if isinstance(patch, Patch) else tuple(patch)
        lead = () if isinstance(patch, Patch) else (len(patches),)
        named = {e.effect for p in patches for e in p.effects}
        present = [record for record in RECORDS.values() if record.id in named]
        self.ignored = tuple(sorted(record.id for record in present if not record.is_simulated))

        def values(effect: str) -> Values:
            def by_joint(name: str) -> np.ndarray:
                return np.array([p.per_joint(effect, name) for p in patches]).reshape(*lead, 7)

            return Values(by_joint, lead, period, seed, np.zeros(lead) + begin)

        on_drive = sorted((r for r in present if r.drive), key=lambda r: r.drive.slot)
        on_sensors = sorted((r for r in present if r.sensors), key=lambda r: r.sensors.slot)
        self._drive = [(r.drive.make(values(r.id)), _share_of_weight(r, values(r.id))) for r in on_drive]
        self._hold = Hold() if any(share is not None for _, share in self._drive) else None
        self._resist = [r.joints(values(r.id)) for r in present if r.joints]
        self._sense = [r.sensors.make(values(r.id)) for r in on_sensors]
        self._left_over = [_left_over(p) for p in patches]

    def drive(self, torque: np.ndarray, q: np.ndarray) -> np.ndarray:
        """What the drives give, Nm, gravity apart, on average over the period in which `torque` Nm is commanded at q rad."""
        torque, held = np.array(torque, dtype=float), 0.0
        if self._hold is not None:
            held = np.array([self._hold(angles) for angles in q.reshape(-1, 7)]).reshape(q.shape)
        for stage, share in self._drive:
            torque = stage(torque) if share is None else stage(torque + share * held) - share * held
        return torque

    def extra(self, q: np.ndarray, dq: np.ndarray) -> np.ndarray:
        """Torque Nm on the joints that nothing else accounts for, at q rad, dq rad/s."""
        torque = np.zeros(q.shape)
        for resist in self._resist:
            torque -= resist(q, dq)
        for left_over, row, angles in zip(self._left_over, torque.reshape(-1, 7), q.reshape(-1, 7)):
            if left_over is not None:
                row += left_over(angles)
        return torque

    def sense(self, q: np.ndarray, dq: np.ndarray, torque: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """What the sensors say of joint angle, speed and torque."""
        for stage in self._sense:
            q, dq, torque = stage(q, dq, torque)
        return q, dq, torque


def _share_of_weight(record: EffectRecord, values: Values) -> np.ndarray | None:
    """Of the compensated gravity in what a stage of the drive acts on, by joint: 1 or 0; None where it has nothing to do
    with it."""
    return 1.0 - np.minimum(values("gravity_apart"), 1.0) if record.drive.of_total else None


def _left_over(patch: Patch) -> LeftOver | None:
    """What gravity leaves on the joints of this arm; None where no effect touches it."""
    weight, changes = (
        Weight(),
        [partial(e.record.weight, component=e.component, values=e.values) for e in patch.effects if e.record.weight],
    )
    for change in changes:
        weight = change(weight)
    return LeftOver(weight, patch.panda()) if changes else None
