"""The stages between target and motion at which an effect may show."""

from __future__ import annotations

from enum import StrEnum


class Stage(StrEnum):
    """A stage; its value is the residual's name in reports and in docs/reference.

    CONTROLLER: commanded torque minus the controller's law replayed. DRIVE: measured minus commanded torque.
    DYNAMICS: torque minus inverse dynamics of the nominal arm. TRANSMISSION: motor minus joint angle.
    """

    CONTROLLER = "r0"
    DRIVE = "r1"
    DYNAMICS = "r2"
    TRANSMISSION = "r3"
