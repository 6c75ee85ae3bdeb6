"""`sim_bridge`: the simulated robot in MuJoCo."""

from __future__ import annotations

from np_description.mujoco_engine import MujocoEngine
from np_ros.node import run
from np_sim_bridge.nodes.bridge import Bridge


class SimBridge(Bridge):
    """The bridge with MuJoCo's physics."""

    def __init__(self):
        super().__init__("sim_bridge", MujocoEngine)


def main(args: list[str] | None = None) -> int:
    """Entry point of the executable `sim_bridge`."""
    return run(SimBridge, args)


if __name__ == "__main__":
    raise SystemExit(main())
