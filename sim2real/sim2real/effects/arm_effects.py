"""What a patch does to commands, joints and measurements, stepped with the physics: the hooks of its records, composed.

What is a number of the rigid-body model is not here (`Patch.panda`). Effects of the controller, and of the motor's side of a
gear, are no simulated arm's to carry: `ignored` names them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from np_common.rotations import namespace
from np_description.panda import NOMINAL
from sim2real.effects.arrays import NUMPY, Arrays
from sim2real.effects.effect import Effect
from sim2real.effects.gravity import GravityModel
from sim2real.effects.hooks import HookContext
from sim2real.effects.patch import Patch
from sim2real.effects.registry import ARM_EFFECTS


class ArmEffects:
    """The effects of one simulated arm, or of many side by side.

    patch: one, and every array below is (7,), or (n, 7) for as many arms as that; or a sequence of S, and they are (S, 7).
    period: s of a control period, in which `drive`, `extra` and `sense` are called once each. seed: of lost packets, the same
    ones in all arms. begin: s for which the arms had been moving, a number or (S,). arrays: NumPy's, or others.

    `friction` Nm is what of the last `extra` is friction of the joints, positive against the motion.
    """

    def __init__(
        self,
        patch: Patch | Sequence[Patch],
        period: float,
        seed: int = 0,
        begin: float | np.ndarray = 0.0,
        arrays: Arrays = NUMPY,
    ):
        patches = tuple(p.arm for p in ((patch,) if isinstance(patch, Patch) else patch))
        lead = () if isinstance(patch, Patch) else (len(patches),)
        named = {e.effect for p in patches for e in p.effects}
        present = [effect for effect in ARM_EFFECTS.values() if effect.id in named]
        self.ignored = tuple(sorted(effect.id for effect in present if not effect.is_simulated))

        def values(effect: str) -> HookContext:
            def by_joint(name: str) -> np.ndarray:
                return np.array([p.per_joint(effect, name) for p in patches]).reshape(*lead, 7)

            library = NUMPY if ARM_EFFECTS[effect].numpy_only else arrays
            return HookContext(by_joint, lead, period, seed, np.zeros(lead) + begin, library)

        drives = sorted((r for r in present if r.drive), key=lambda r: r.drive.slot)
        sensors = sorted((r for r in present if r.sensors), key=lambda r: r.sensors.slot)
        own = partial(_convert_arrays, arrays)
        self._drive = [(own(r, r.drive.make(values(r.id))), _gravity_share(r, values(r.id))) for r in drives]
        self._hold = arrays.hold(NOMINAL) if any(share is not None for _, share in self._drive) else None
        self._resist = [own(r, r.joints(values(r.id))) for r in present if r.joints]
        self._sense = [own(r, r.sensors.make(values(r.id))) for r in sensors]
        self._gravity_error = (
            _make_gravity_error(patches[0], arrays) if isinstance(patch, Patch) else _make_gravity_errors(patch, arrays)
        )

    def drive(self, torque: np.ndarray, q: np.ndarray) -> np.ndarray:
        """What the drives give, Nm, gravity apart, on average over the period in which `torque` Nm is commanded at q rad."""
        torque = namespace(torque).asarray(torque, copy=True)
        gravity = 0.0 if self._hold is None else self._hold(q)
        for stage, share in self._drive:
            torque = stage(torque) if share is None else stage(torque + share * gravity) - share * gravity
        return torque

    def extra(self, q: np.ndarray, dq: np.ndarray) -> np.ndarray:
        """Torque Nm on the joints that nothing else accounts for, at q rad, dq rad/s."""
        torque = namespace(q).zeros_like(q)
        for resist in self._resist:
            torque = torque - resist(q, dq)
        self.friction = -torque
        return torque if self._gravity_error is None else torque + self._gravity_error(q)

    def sense(self, q: np.ndarray, dq: np.ndarray, torque: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """What the sensors measure of joint angle, speed and torque."""
        for stage in self._sense:
            q, dq, torque = stage(q, dq, torque)
        return q, dq, torque


def _gravity_share(effect: Effect, values: HookContext) -> np.ndarray | None:
    """Of the compensated gravity in what a stage of the drive acts on, by joint: 1 or 0; None where it has nothing to do
    with it."""
    return 1.0 - values("gravity_apart").clip(None, 1.0) if effect.drive.of_total else None


def _convert_arrays(arrays: Arrays, effect: Effect, hook: Callable) -> Callable:
    """The hook, which gets arrays of the library that it was written for."""
    if arrays is NUMPY or not effect.numpy_only:
        return hook

    def through_numpy(*values):
        results = hook(*(np.asarray(value.cpu(), dtype=float) for value in values))
        return tuple(map(arrays.array, results)) if isinstance(results, tuple) else arrays.array(results)

    return through_numpy


GravityErrorFunction = Callable[[np.ndarray], np.ndarray]
"""What gravity leaves on the joints, Nm, at angles (..., 7) rad: compensation minus weight."""


def _make_gravity_error(patch: Patch, arrays: Arrays) -> GravityErrorFunction | None:
    """Of this arm; None where no effect touches it."""
    weight = GravityModel()
    changes = [
        partial(e.definition.gravity_error, component=e.component, values=e.values)
        for e in patch.effects
        if e.definition.gravity_error
    ]
    for change in changes:
        weight = change(weight)
    if not changes:
        return None
    nominal, real, bias = arrays.hold(NOMINAL), arrays.hold(patch.panda(), weight.tilt), arrays.array(weight.bias)
    return lambda q: weight.share * nominal(q + bias) - real(q)


def _make_gravity_errors(patches: Sequence[Patch], arrays: Arrays) -> GravityErrorFunction | None:
    """Of arms side by side (S, 7). Those of one patch (windows of a recording are hundreds) have one arm's model among them."""
    rows: dict[int, list[int]] = {}
    for row, patch in enumerate(patches):
        rows.setdefault(id(patch), []).append(row)
    found = [(own, _make_gravity_error(patches[own[0]].arm, arrays)) for own in rows.values()]
    parts = [(own, part) for own, part in found if part is not None]
    if not parts:
        return None

    def gravity_error(q: np.ndarray) -> np.ndarray:
        torque = np.zeros((len(patches), 7))
        for own, part in parts:
            torque[own] = part(q[own])
        return torque

    return gravity_error
