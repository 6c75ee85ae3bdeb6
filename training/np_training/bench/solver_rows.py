"""Constraint rows of states as MuJoCo in C makes and solves them in float64, and the same rows for a solver on a device."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import mujoco_warp as mjw
import numpy as np
import warp as wp

EXACT = dict(iterations=200, ls_iterations=100, tolerance=1e-14)


@dataclass(frozen=True)
class SolvedRows:
    """One state: what a solver gets, and MuJoCo's solution. nv degrees of freedom, n rows, c contacts."""

    jacobian: np.ndarray
    """(n, nv)"""
    stiffness: np.ndarray
    """(n,), 1 / regularisation"""
    wanted: np.ndarray
    """(n,), reference acceleration"""
    loss: np.ndarray
    """(n,), friction loss, N or Nm"""
    kinds: np.ndarray
    """(n,), mjtConstraint"""
    contacts: np.ndarray
    """(n,), number of the contact of a contact's row"""
    equalities: int
    """First rows"""
    frictions: int
    """Rows of friction loss after them"""
    addresses: np.ndarray
    """(c,), first row of a contact, -1: none"""
    coefficients: np.ndarray
    """(c, 5), of friction"""
    inertia: np.ndarray
    """(nC,), sparse, as in MjData.M"""
    start: np.ndarray
    """(nv,), acceleration of the warm start"""
    smooth: np.ndarray
    """(nv,), N or Nm, force without constraints"""
    unconstrained: np.ndarray
    """(nv,), acceleration without constraints"""
    acceleration: np.ndarray
    """(nv,), MuJoCo's solution"""
    force: np.ndarray
    """(n,), MuJoCo's solution"""
    states: np.ndarray
    """(n,), mjtConstraintState"""


def solve_in_c(model: mujoco.MjModel, states: dict[str, np.ndarray]) -> list[SolvedRows]:
    """Rows and exact solutions of states: qpos (k, nq), qvel, qacc_warmstart (k, nv), ctrl (k, nu). The model is left as it is."""
    kept = {name: getattr(model.opt, name) for name in EXACT}
    for name, value in EXACT.items():
        setattr(model.opt, name, value)
    data, solved = mujoco.MjData(model), []
    for k in range(len(states["qpos"])):
        for name, values in states.items():
            getattr(data, name)[:] = values[k]
        mujoco.mj_forward(model, data)
        touching = [data.contact[c] for c in range(data.ncon)]
        solved.append(
            SolvedRows(
                data.efc_J.reshape(data.nefc, model.nv).copy(),
                data.efc_D.copy(),
                data.efc_aref.copy(),
                data.efc_frictionloss.copy(),
                data.efc_type.copy(),
                data.efc_id.copy(),
                data.ne,
                data.nf,
                np.array([contact.efc_address for contact in touching], dtype=int),
                np.array([contact.friction for contact in touching]).reshape(-1, 5),
                data.M.copy(),
                states["qacc_warmstart"][k],
                data.qfrc_smooth.copy(),
                data.qacc_smooth.copy(),
                data.qacc.copy(),
                data.efc_force.copy(),
                data.efc_state.copy(),
            )
        )
    for name, value in kept.items():
        setattr(model.opt, name, value)
    return solved


def device_data(model: mujoco.MjModel, solved: list[SolvedRows]) -> mjw.Data:
    """Data on Warp's current device whose worlds have these rows, ready for a solver."""
    worlds, rows = len(solved), max(len(s.wanted) for s in solved)
    contacts = max(1, max(len(s.addresses) for s in solved))
    d = mjw.make_data(model, nworld=worlds, nconmax=contacts, njmax=rows)

    def fill(array: wp.array, values: list[np.ndarray]) -> None:
        whole = array.numpy()
        whole[:] = 0
        for k, value in enumerate(values):
            whole[(k, *(slice(size) for size in value.shape))] = value
        array.assign(whole)

    elliptic = int(mujoco.mjtConstraint.mjCNSTR_CONTACT_ELLIPTIC)
    fill(d.efc.J, [s.jacobian for s in solved])
    fill(d.efc.D, [s.stiffness for s in solved])
    fill(d.efc.aref, [s.wanted for s in solved])
    fill(d.efc.frictionloss, [s.loss for s in solved])
    fill(d.efc.type, [s.kinds for s in solved])
    # The contacts of all worlds are in one array.
    fill(d.efc.id, [s.contacts + np.where(s.kinds == elliptic, k * contacts, 0) for k, s in enumerate(solved)])
    fill(d.M, [s.inertia for s in solved])
    fill(d.qacc_warmstart, [s.start for s in solved])
    fill(d.qfrc_smooth, [s.smooth for s in solved])
    fill(d.qacc_smooth, [s.unconstrained for s in solved])
    for array, values in (
        (d.ne, [s.equalities for s in solved]),
        (d.nf, [s.frictions for s in solved]),
        (d.nefc, [len(s.wanted) for s in solved]),
    ):
        array.assign(np.array(values, dtype=np.int32))
    address, friction = np.full(d.contact.efc_address.shape, -1), np.ones((d.naconmax, 5))
    for k, s in enumerate(solved):
        mine = slice(k * contacts, k * contacts + len(s.addresses))
        for direction in range(3):
            address[mine, direction] = np.where(s.addresses < 0, -1, s.addresses + direction)
        friction[mine] = s.coefficients
    d.contact.efc_address.assign(address.astype(np.int32))
    d.contact.friction.assign(friction.astype(np.float32))
    d.contact.worldid.assign(np.repeat(np.arange(worlds, dtype=np.int32), contacts))
    d.contact.dist.assign(np.full(d.naconmax, -1.0, dtype=np.float32))  # the library bends no cost without penetration
    d.contact.dim.assign(np.full(d.naconmax, 3, dtype=np.int32))
    d.nacon.assign(np.array([worlds * contacts], dtype=np.int32))
    return d
