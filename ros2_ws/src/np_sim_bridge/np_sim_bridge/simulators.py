"""Which simulated robots there are: by the engine whose physics one has, the node that stands in for the drivers."""

from __future__ import annotations

from np_ros.processes.graph import NodeSpec

SIMULATORS = {
    "mujoco": NodeSpec("np_sim_bridge", "sim_bridge"),
    "physx": NodeSpec("np_physx_bridge", "physx_bridge"),  # an extra, and a package of its own, above this one
}
