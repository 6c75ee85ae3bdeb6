"""`physx_bridge`: the simulated robot in PhysX."""

from __future__ import annotations

from np_physx_bridge.engine import PhysxEngine
from np_ros.node import run
from np_sim_bridge.nodes.bridge import Bridge


class PhysxBridge(Bridge):
    """The bridge with PhysX's physics."""

    def __init__(self):
        super().__init__("physx_bridge", PhysxEngine)


def main(args: list[str] | None = None) -> int:
    """Entry point of the executable `physx_bridge`."""
    return run(PhysxBridge, args)


if __name__ == "__main__":
    raise SystemExit(main())
