"""The robots that the driver can drive: a name chooses the client of the protocol and the limits. No ROS."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from types import ModuleType

from np_control.safety import SafetyLimits
from np_franka.client import ArmError, Client
from np_franka.limits import FR3_LIMITS, PANDA_LIMITS


@dataclass(frozen=True, eq=False)
class RobotKind:
    """One kind of robot. package: what its client needs; module: where that client is; client: its class
    there. A package is imported when its robot is chosen."""

    name: str
    package: str
    module: str
    client: str
    limits: SafetyLimits

    def open(self, hostname: str, *, enforce_realtime: bool) -> Client:
        """Connect to the robot at `hostname`. Raises ArmError."""
        return getattr(self.load(), self.client)(hostname, enforce_realtime=enforce_realtime)

    def load(self) -> ModuleType:
        """The client's module, which also has `Gripper`. Raises ArmError without the package."""
        try:
            return import_module(self.module)
        except ModuleNotFoundError as error:
            raise ArmError(
                f"robot:={self.name}: expected the package {self.package}, which `make hardware` installs: {error}"
            ) from error


ROBOTS = {
    kind.name: kind
    for kind in (
        RobotKind("fr3", "pylibfranka", "np_franka.fr3_client", "Fr3Client", FR3_LIMITS),
        RobotKind("panda", "panda_py", "np_franka.panda_client", "PandaClient", PANDA_LIMITS),
    )
}
