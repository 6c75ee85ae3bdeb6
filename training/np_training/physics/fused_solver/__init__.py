"""The contact solver of the training: Newton's method for a whole world in one kernel.

MuJoCo Warp launches about ten kernels an iteration, over all rows that a world has room for, until the slowest world has
converged. Here a warp takes a world through all its iterations in shared memory and leaves when that world has converged.
`newton.cuh` is the method, `kernel.py` launches it, `solve.py` puts it in a physics step and checks which scenes it fits.
"""

from np_training.physics.fused_solver.solve import choose_step, misfit, step_fused

__all__ = ["choose_step", "misfit", "step_fused"]
