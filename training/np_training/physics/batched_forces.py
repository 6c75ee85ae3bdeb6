"""External forces in every world as the robot estimates them: np_description.force_reflex as a kernel of Warp.

The external torque of a joint is what the model needs minus what is measured. In a simulated step that is the solver's constraint force
without the rows of joint friction and joint limits, which the model has: M qdd + h - tau - friction. A test holds the kernel to a
momentum observer, which reads positions, velocities and commands only, and to the functions of np_description.force_reflex.
"""

from __future__ import annotations

from math import exp

import mujoco
import torch
import warp as wp

from np_description.contact.penetration import kind_of, pair_of
from np_description.force_reflex import FORCE_REFLEX, WRENCH_DAMPING
from np_training.physics.chain import (
    KinematicChain,
    cholesky,
    cholesky_solve,
    jacobian,
    joint_frames,
    make_chain,
    posture,
    times_transposed,
    vec6,
    vec7,
)

wp.set_module_options({"max_unroll": 1, "enable_backward": False})

TOUCH = 0.5  # N, from which a raw force is a touch: the solver's residual lies far below
APART = 0.05  # s without a touch, after which the next one is a first touch
FORCE, RAW, SHARE, SPEED = range(4)  # rows of `peaks`
FINGER, BARE = range(2)  # rows of `touched`
_FIRST_CONTACT = wp.constant(int(mujoco.mjtConstraint.mjCNSTR_CONTACT_FRICTIONLESS))
_FORCE, _RAW, _SHARE, _SPEED = (wp.constant(row) for row in (FORCE, RAW, SHARE, SPEED))
_TOUCH, _DAMPING = wp.constant(TOUCH), wp.constant(WRENCH_DAMPING)


@wp.func
def length3(wrench: vec6, first: int):
    """Norm of three components of a wrench from index `first` on."""
    return wp.length(wp.vec3(wrench[first], wrench[first + 1], wrench[first + 2]))


@wp.kernel
def force_kernel(
    substep: int,
    chain: KinematicChain,
    blend: float,
    apart_steps: int,
    threshold: vec7,
    most_force: float,
    most_moment: float,
    qpos: wp.array2d(dtype=float),
    qvel: wp.array2d(dtype=float),
    constraint: wp.array2d(dtype=float),
    rows: wp.array(dtype=int),
    kind: wp.array2d(dtype=int),
    row_jacobian: wp.array3d(dtype=float),
    row_force: wp.array2d(dtype=float),
    filtered: wp.array2d(dtype=float),
    velocity: wp.array(dtype=wp.vec3),
    apart: wp.array(dtype=int),
    peaks: wp.array2d(dtype=float),
    touched: wp.array2d(dtype=int),
):
    """The forces of the physics step just made in world i.

    filtered (worlds, 7) Nm: external torque after the reflex's filter; velocity (worlds,) m/s: of T_E at the step's end; apart (worlds,):
    steps without a touch; peaks (4, worlds): the period's largest filtered force N, raw force N, share of a threshold, and speed of a
    first touch along its force m/s; touched (2, worlds): cleared at a period's beginning.
    """
    i = wp.tid()
    if substep == 0:
        for row in range(4):
            peaks[row, i] = 0.0
        for row in range(2):
            touched[row, i] = 0
    raw = vec7()
    for j in range(7):
        raw[j] = constraint[i, j]
    for row in range(rows[i]):
        if kind[i, row] < _FIRST_CONTACT:
            for j in range(7):
                raw[j] = raw[j] - row_jacobian[i, row, j] * row_force[i, row]
    share = float(0.0)
    smooth = vec7()
    for j in range(7):
        smooth[j] = filtered[i, j] + blend * (raw[j] - filtered[i, j])
        filtered[i, j] = smooth[j]
        share = wp.max(share, wp.abs(smooth[j]) / threshold[j])

    at, turned, frames = joint_frames(chain, posture(qpos, i))
    jac = jacobian(at, frames)
    normal = times_transposed(jac, jac)
    raw_wrench = vec6()
    wrench = vec6()
    moving = wp.vec3(0.0, 0.0, 0.0)
    for k in range(6):
        normal[k, k] = normal[k, k] + _DAMPING * _DAMPING
        for j in range(7):
            raw_wrench[k] = raw_wrench[k] + jac[k, j] * raw[j]
            wrench[k] = wrench[k] + jac[k, j] * smooth[j]
            if k < 3:
                moving[k] = moving[k] + jac[k, j] * qvel[i, j]
    lower = cholesky(normal, 6)
    raw_wrench = cholesky_solve(lower, raw_wrench, 6)
    wrench = cholesky_solve(lower, wrench, 6)
    force = length3(wrench, 0)
    raw_force = length3(raw_wrench, 0)
    share = wp.max(share, wp.max(force / most_force, length3(wrench, 3) / most_moment))
    peaks[_FORCE, i] = wp.max(peaks[_FORCE, i], force)
    peaks[_RAW, i] = wp.max(peaks[_RAW, i], raw_force)
    peaks[_SHARE, i] = wp.max(peaks[_SHARE, i], share)
    if raw_force > _TOUCH:
        if apart[i] >= apart_steps:
            along = wp.vec3(raw_wrench[0], raw_wrench[1], raw_wrench[2]) / raw_force
            peaks[_SPEED, i] = wp.max(peaks[_SPEED, i], -wp.dot(velocity[i], along))
        apart[i] = 0
    else:
        apart[i] = apart[i] + 1
    velocity[i] = moving


@wp.kernel
def touch_kernel(
    count: wp.array(dtype=int),
    depth: wp.array(dtype=float),
    geoms: wp.array(dtype=wp.vec2i),
    world: wp.array(dtype=int),
    table: wp.array2d(dtype=int),
    touched: wp.array2d(dtype=int),
):
    """Mark the worlds in which contact c is one of the robot with the object; table (geoms, geoms): row of `touched`, or -1."""
    c = wp.tid()
    if c >= count[0] or depth[c] >= 0.0:
        return
    row = table[geoms[c][0], geoms[c][1]]
    if row >= 0:
        touched[row, world[c]] = 1


class BatchedForces:
    """Watches the forces of every physics step of a period.

    peaks (4, worlds): rows FORCE, RAW, SHARE, SPEED; touched (2, worlds): whether fingertips (FINGER), housing or links (BARE) touched the
    object in the period.
    """

    def __init__(self, data, worlds: int, timestep: float, names: list[str]) -> None:
        """data: MuJoCo Warp's; names: of the model's geoms. Call it with the device in scope."""
        self._data, self._worlds = data, worlds
        self._blend = 1 - exp(-timestep / FORCE_REFLEX.time_constant)
        self._apart_steps = round(APART / timestep)
        self._threshold = vec7(*map(float, FORCE_REFLEX.torques()))
        self._filtered = wp.zeros((worlds, 7), dtype=float)
        self._velocity = wp.zeros(worlds, dtype=wp.vec3)
        self._apart = wp.full(worlds, self._apart_steps, dtype=int)
        self._peaks = wp.zeros((4, worlds), dtype=float)
        self._touched = wp.zeros((2, worlds), dtype=int)
        self._table = wp.array([[_row_of(one, other) for other in names] for one in names], dtype=int)
        self._chain = make_chain(self._filtered.device.alias)
        self.filtered, self.apart = wp.to_torch(self._filtered), wp.to_torch(self._apart)
        self.velocity = wp.to_torch(self._velocity)
        self.peaks, self.touched = wp.to_torch(self._peaks), wp.to_torch(self._touched)

    def watch(self, substep: int) -> None:
        """Take in the physics step just made, the period's `substep`-th; only kernels, so that it can be captured."""
        d = self._data
        wp.launch(
            force_kernel,
            dim=self._worlds,
            inputs=[
                substep,
                self._chain,
                self._blend,
                self._apart_steps,
                self._threshold,
                FORCE_REFLEX.force,
                FORCE_REFLEX.moment,
                d.qpos,
                d.qvel,
                d.qfrc_constraint,
                d.nefc,
                d.efc.type,
                d.efc.J,
                d.efc.force,
            ],
            outputs=[self._filtered, self._velocity, self._apart, self._peaks, self._touched],
        )
        c = d.contact
        wp.launch(
            touch_kernel,
            dim=len(c.dist),
            inputs=[d.nacon, c.dist, c.geom, c.worldid, self._table],
            outputs=[self._touched],
        )

    def place(self, where: torch.Tensor) -> None:
        """Clear the forces of the worlds `where` (n,), which begin anew at rest."""
        self.filtered[where], self.velocity[where] = 0.0, 0.0
        self.apart[where] = self._apart_steps


def _row_of(one: str, other: str) -> int:
    pair = pair_of(kind_of(one), kind_of(other))
    if pair == "finger-object":
        return FINGER
    return BARE if pair in ("housing-object", "link-object") else -1
