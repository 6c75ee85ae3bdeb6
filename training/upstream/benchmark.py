"""The patched library's two contact solvers on one scene: time a step, and how far the boxes end apart.

    python benchmark.py --worlds 24576 --steps 250

Needs only MuJoCo Warp with fused_newton.patch. Prints one line of JSON.
"""

from __future__ import annotations

import argparse
import json
import time
from unittest.mock import patch

import mujoco
import mujoco_warp as mjw
import numpy as np
import warp as wp
from mujoco_warp._src import solver_fused

SCENE = """
<mujoco>
  <option timestep="0.004" cone="elliptic" iterations="8" ls_iterations="20" jacobian="dense"/>
  <worldbody>
    <geom type="plane" size="1 1 .1" friction=".4"/>
    <body pos=".5 0 .05"><freejoint/><geom type="box" size=".05 .05 .05" mass=".15" friction=".4"/></body>
    <body pos="0 0 .05">
      <joint name="push" axis="0 0 1" damping="1" frictionloss=".2"/><geom type="capsule" fromto="0 0 0 .25 0 0" size=".02"/>
      <body pos=".25 0 0">
        <joint axis="0 0 1" damping="1" frictionloss=".2"/><geom type="capsule" fromto="0 0 0 .22 .1 0" size=".02"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor joint="push" gear="1"/></actuator>
</mujoco>
"""


def run(worlds: int, steps: int) -> tuple[float, np.ndarray]:
    """Seconds a step, and positions (worlds, nq) at the end, of boxes pushed by arms with different torques."""
    model = mujoco.MjModel.from_xml_string(SCENE)
    m, d = mjw.put_model(model), mjw.put_data(model, mujoco.MjData(model), nworld=worlds, nconmax=16, njmax=64)
    d.ctrl.assign(np.linspace(-0.5, -3.0, worlds, dtype=np.float32)[:, None])
    mjw.step(m, d)
    wp.synchronize()
    graph = None
    if wp.get_device().is_cuda:
        with wp.ScopedCapture() as capture:
            mjw.step(m, d)
        graph = capture.graph
    begin = time.perf_counter()
    for _ in range(steps):
        wp.capture_launch(graph) if graph else mjw.step(m, d)
    wp.synchronize()
    return (time.perf_counter() - begin) / steps, d.qpos.numpy()


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--worlds", type=int, default=24576)
    parser.add_argument("--steps", type=int, default=250)
    arguments = parser.parse_args()
    fused, position = run(arguments.worlds, arguments.steps)
    with patch.object(solver_fused, "misfit", return_value="switched off"):
        general, other = run(arguments.worlds, arguments.steps)
    apart = 1e3 * np.linalg.norm(position[:, :3] - other[:, :3], axis=1)
    figures = {"worlds": arguments.worlds, "general_ms": 1e3 * general, "fused_ms": 1e3 * fused}
    figures |= {"moved_mm": 1e3 * float(np.median(np.linalg.norm(position[:, :2] - [0.5, 0], axis=1)))}
    print(json.dumps(figures | {"apart_mm_median": float(np.median(apart)), "apart_mm_max": float(apart.max())}))


if __name__ == "__main__":
    main()
