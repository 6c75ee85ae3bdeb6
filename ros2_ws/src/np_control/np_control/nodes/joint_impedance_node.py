"""`joint_impedance`: the 500 Hz joint impedance controller."""

from np_control.nodes.controller import ControllerNode
from np_ros.node import run


class JointImpedance(ControllerNode):
    """See `ControllerNode`."""

    def __init__(self):
        super().__init__("joint_impedance")


def main(args=None) -> int:
    """Entry point of the executable `joint_impedance`."""
    return run(JointImpedance, args)


if __name__ == "__main__":
    raise SystemExit(main())
