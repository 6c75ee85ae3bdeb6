"""What a contact solver minimises, in float64, written down once more: cost, gradient and Hessian of MuJoCo's primal problem."""

from __future__ import annotations

import mujoco
import numpy as np

from np_training.bench.solver_rows import SolvedRows

ELLIPTIC = int(mujoco.mjtConstraint.mjCNSTR_CONTACT_ELLIPTIC)


def dense(model: mujoco.MjModel, sparse: np.ndarray) -> np.ndarray:
    """Inertia (nv, nv)."""
    full = np.zeros((model.nv, model.nv))
    for i in range(model.nv):
        for k in range(model.M_rowadr[i], model.M_rowadr[i] + model.M_rownnz[i]):
            full[i, model.M_colind[k]] = full[model.M_colind[k], i] = sparse[k]
    return full


def row_cost(model: mujoco.MjModel, rows: SolvedRows, x: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Cost of all rows at x (n,), its gradient (n,) and Hessian (n, n) by x."""
    cost, slope, curvature = 0.0, np.zeros_like(x), np.zeros((len(x), len(x)))
    r = 0
    while r < len(x):
        stiff = rows.stiffness[r]
        if rows.kinds[r] == ELLIPTIC:
            three = slice(r, r + 3)
            value = cone_cost(model, rows, r, x[three])
            cost, slope[three], curvature[three, three] = cost + value[0], value[1], value[2]
            r += 3
            continue
        is_friction = rows.equalities <= r < rows.equalities + rows.frictions
        reach = rows.loss[r] / stiff
        if is_friction and abs(x[r]) >= reach:
            cost += rows.loss[r] * (abs(x[r]) - reach / 2)
            slope[r] = np.sign(x[r]) * rows.loss[r]
        elif is_friction or r < rows.equalities or x[r] < 0:
            cost, slope[r], curvature[r, r] = cost + stiff * x[r] ** 2 / 2, stiff * x[r], stiff
        r += 1
    return cost, slope, curvature


def cone_cost(model: mujoco.MjModel, rows: SolvedRows, r: int, x: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Of a contact with its normal at row r and x (3,): half the weight times the squared distance to the cone between the zones."""
    first, second = rows.coefficients[rows.contacts[r]][:2]
    mu = first / np.sqrt(model.opt.impratio)
    scaled = x * [mu, first, second]
    tangential = np.hypot(*scaled[1:])
    stiff = rows.stiffness[r : r + 3]
    if scaled[0] >= mu * tangential:
        return 0.0, np.zeros(3), np.zeros((3, 3))
    if mu * scaled[0] + tangential <= 0:
        return float(stiff @ x**2) / 2, stiff * x, np.diag(stiff)
    weight = stiff[0] / (mu**2 * (1 + mu**2))
    gap = scaled[0] - mu * tangential
    direction = scaled[1:] / tangential
    gap_slope = np.array([mu, *(-mu * direction * [first, second])])
    bend = np.zeros((3, 3))
    bend[1:, 1:] = (
        -mu / tangential * np.outer([first, second], [first, second]) * (np.eye(2) - np.outer(direction, direction))
    )
    return weight * gap**2 / 2, weight * gap * gap_slope, weight * (np.outer(gap_slope, gap_slope) + gap * bend)


def primal(model: mujoco.MjModel, rows: SolvedRows, a: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Cost of an acceleration a (nv,), its gradient (nv,) and its Hessian (nv, nv)."""
    inertia = dense(model, rows.inertia)
    cost, slope, curvature = row_cost(model, rows, rows.jacobian @ a - rows.wanted)
    away = a - np.linalg.solve(inertia, rows.smooth)
    return (
        float(away @ inertia @ away) / 2 + cost,
        inertia @ away + rows.jacobian.T @ slope,
        inertia + rows.jacobian.T @ curvature @ rows.jacobian,
    )
