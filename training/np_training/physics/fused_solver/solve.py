"""`mujoco_warp.step` with the constraints solved by one kernel."""

from __future__ import annotations

import logging
from collections.abc import Callable

import mujoco_warp as mjw
import warp as wp
from mujoco_warp._src import smooth, solver, types

from np_training.physics.fused_solver.kernel import newton_kernel

SIZES = (44, 112, 192)
"""Most rows of the kernels: the less shared memory a world needs, the more worlds a multiprocessor holds."""
MOST_DOFS = 16
LANES = 32


def misfit(m: mjw.Model, d: mjw.Data) -> str | None:
    """Why this scene needs the library's solver, as "expected X, got Y"; None if it does not."""
    options, wanted = m.opt, types.SolverType.NEWTON
    for what, holds, got in (
        ("Newton's method", options.solver == wanted, options.solver),
        (f"at most {MOST_DOFS} degrees of freedom", 0 < m.nv <= MOST_DOFS, m.nv),
        ("a dense Jacobian", not m.is_sparse, "a sparse one"),
        (f"room for at most {SIZES[-1]} constraints", 0 < d.njmax <= SIZES[-1], d.njmax),
        ("contacts with at most three directions", m.nmaxcondim <= 3, m.nmaxcondim),
        ("no noslip iterations", options.noslip_iterations == 0, options.noslip_iterations),
        ("an integrator other than discrete", options.integrator != types.IntegratorType.DISCRETE, "discrete"),
        ("a warm start", not options.disableflags & types.DisableBit.WARMSTART, "none"),
        ("no sleeping", not options.enableflags & types.EnableBit.SLEEP, "sleeping"),
    ):
        if not holds:
            return f"expected {what}, got {got}"
    return None


def solve(m: mjw.Model, d: mjw.Data) -> None:
    """Solve the constraints of all worlds, like `mujoco_warp._src.solver.solve`, for a scene without `misfit`.

    Reads the rows (efc), the inertia, the warm start and the smooth forces; writes qacc, qfrc_constraint, solver_niter,
    overflow and of the rows force, state and Ma.
    """
    has_smooth = not smooth.skip_qacc_smooth(m, d)
    lanes = LANES if d.qacc.device.is_cuda else 1
    for least, most in zip((0, *(size + 1 for size in SIZES)), SIZES):
        if least > d.njmax:
            break
        wp.launch(
            newton_kernel(m.nv, least, most),
            dim=(d.nworld, lanes),
            inputs=[
                int(has_smooth),
                m.opt.iterations,
                m.opt.ls_iterations,
                d.ne,
                d.nf,
                d.nefc,
                m.M_rownnz,
                m.M_rowadr,
                m.M_colind,
                d.M,
                d.efc.J,
                d.efc.D,
                d.efc.aref,
                d.efc.frictionloss,
                d.efc.type,
                d.efc.id,
                d.contact.efc_address,
                d.contact.friction,
                m.opt.impratio_invsqrt,
                m.opt.tolerance,
                m.opt.ls_tolerance,
                d.qacc_warmstart,
                d.qacc_smooth,
                d.qfrc_smooth,
            ],
            outputs=[
                d.qacc,
                d.efc.Ma,
                d.qfrc_constraint,
                d.efc.force,
                d.efc.state,
                d.solver_niter,
                d.overflow,
            ],
            block_dim=lanes if lanes > 1 else 256,
        )


def step_fused(m: mjw.Model, d: mjw.Data) -> None:
    """One physics step like `mujoco_warp.step`, for a scene without `misfit`."""
    librarys = solver.solve
    solver.solve = solve  # forward dynamics look it up there
    try:
        mjw.step(m, d)
    finally:
        solver.solve = librarys


def choose_step(m: mjw.Model, d: mjw.Data, fused: bool) -> Callable[[mjw.Model, mjw.Data], None]:
    """The physics step for a scene: `step_fused` if requested and possible, else `mujoco_warp.step`, with a line in the log."""
    if not fused:
        return mjw.step
    if why := misfit(m, d):
        logging.getLogger(__name__).warning("the library's contact solver is used: %s", why)
        return mjw.step
    return step_fused
