"""`operational_space`: the baseline that follows targets of T_E in operational space."""

from np_control.nodes.controller import ControllerNode
from np_ros.node import run


class OperationalSpace(ControllerNode):
    """See `ControllerNode`."""

    def __init__(self):
        super().__init__("operational_space", is_cartesian=True)


def main(args=None) -> int:
    """Entry point of the executable `operational_space`."""
    return run(OperationalSpace, args)


if __name__ == "__main__":
    raise SystemExit(main())
