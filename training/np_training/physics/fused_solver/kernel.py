"""The kernel around `newton.cuh`: one warp a world, one kernel for worlds of few rows and others for worlds of many."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import warp as wp
from mujoco_warp._src import types

SOURCE = Path(__file__).with_name("newton.cuh")

Numbers, Numbers2, Numbers3 = wp.array(dtype=float), wp.array2d(dtype=float), wp.array3d(dtype=float)
Counts, Counts2, Friction = wp.array(dtype=int), wp.array2d(dtype=int), wp.array(dtype=types.vec5)


@cache
def newton_kernel(nv: int, least: int, most: int) -> wp.Kernel:
    """Kernel over (worlds, lanes) that solves the worlds of `least` to `most` constraint rows and leaves the others alone.

    nv: degrees of freedom. Shared memory of a world: about 4 (18 + nv) + 22 bytes a row, and 8 nv (nv + 5) bytes.
    """
    constants = {
        "NV": nv,
        "ROWS": most,
        "ELLIPTIC": int(types.ConstraintType.CONTACT_ELLIPTIC),
        "TOO_FEW_ITERATIONS": int(types.OverflowType.ITERATIONS),
    }
    text = "".join(f"    const int {name} = {value};\n" for name, value in constants.items())

    @wp.func_native(text + SOURCE.read_text(encoding="utf-8"))
    def newton(
        world: int,
        lane: int,
        rows: int,
        equalities: int,
        frictions: int,
        has_smooth: int,
        iterations: int,
        ls_iterations: int,
        M_rownnz: Counts,
        M_rowadr: Counts,
        M_colind: Counts,
        M_in: Numbers2,
        efc_J: Numbers3,
        efc_D: Numbers2,
        efc_aref: Numbers2,
        efc_frictionloss: Numbers2,
        efc_type: Counts2,
        efc_id: Counts2,
        contact_address: Counts2,
        contact_friction: Friction,
        impratio_invsqrt: Numbers,
        tolerance: Numbers,
        ls_tolerance: Numbers,
        warmstart: Numbers2,
        qacc_smooth: Numbers2,
        qfrc_smooth: Numbers2,
        qacc: Numbers2,
        efc_Ma: Numbers2,
        qfrc_constraint: Numbers2,
        efc_force: Numbers2,
        efc_state: Counts2,
        solver_niter: Counts,
        overflow: Counts,
    ): ...

    @wp.kernel(module="unique", enable_backward=False, grid_stride=False)
    def solve_worlds(
        has_smooth: int,
        iterations: int,
        ls_iterations: int,
        ne: Counts,
        nf: Counts,
        nefc: Counts,
        M_rownnz: Counts,
        M_rowadr: Counts,
        M_colind: Counts,
        M_in: Numbers2,
        efc_J: Numbers3,
        efc_D: Numbers2,
        efc_aref: Numbers2,
        efc_frictionloss: Numbers2,
        efc_type: Counts2,
        efc_id: Counts2,
        contact_address: Counts2,
        contact_friction: Friction,
        impratio_invsqrt: Numbers,
        tolerance: Numbers,
        ls_tolerance: Numbers,
        warmstart: Numbers2,
        qacc_smooth: Numbers2,
        qfrc_smooth: Numbers2,
        qacc: Numbers2,
        efc_Ma: Numbers2,
        qfrc_constraint: Numbers2,
        efc_force: Numbers2,
        efc_state: Counts2,
        solver_niter: Counts,
        overflow: Counts,
    ):
        world, lane = wp.tid()
        # D, J and state are padded beyond the room for rows; force is not.
        rows = wp.min(nefc[world], efc_force.shape[1])
        if rows < wp.static(least) or rows > wp.static(most):
            return
        newton(
            world,
            lane,
            rows,
            ne[world],
            nf[world],
            has_smooth,
            iterations,
            ls_iterations,
            M_rownnz,
            M_rowadr,
            M_colind,
            M_in,
            efc_J,
            efc_D,
            efc_aref,
            efc_frictionloss,
            efc_type,
            efc_id,
            contact_address,
            contact_friction,
            impratio_invsqrt,
            tolerance,
            ls_tolerance,
            warmstart,
            qacc_smooth,
            qfrc_smooth,
            qacc,
            efc_Ma,
            qfrc_constraint,
            efc_force,
            efc_state,
            solver_niter,
            overflow,
        )

    return solve_worlds
