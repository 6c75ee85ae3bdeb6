"""What must hold before the arm may be moved. No ROS, no client: facts in, reasons out."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime, timedelta

import numpy as np

from np_control.impedance import damping
from np_control.safety import Refusal, SafetyLimits, limit_gains
from np_control.safety.filter import HOLD_DAMPING_RATIO, HOLD_STIFFNESS
from np_description import calibration
from np_description.panda import NOMINAL

READY_MODE = "Idle"
NO_CALIBRATION = "none"
MASS_TOLERANCE = 0.1  # kg: less than any other tool differs, more than rounding in Desk


@dataclass(frozen=True)
class RobotFacts:
    """What the robot reports.

    mode: as the robot names it; errors: those that it has, or empty; end_effector_mass, load_mass kg: what it
    compensates at its flange."""

    mode: str
    errors: str
    end_effector_mass: float
    load_mass: float


@dataclass(frozen=True, eq=False)
class Checklist:
    """The conditions of start-up and of every recovery.

    calibration: path of the camera's calibration, or `none` for a run that needs no camera;
    calibration_max_age: how old it may be. stiffness (7,) Nm/rad and damping_ratio (7,): the gains that the
    driver uses of itself besides its hold. limits: with the period at which they act."""

    calibration: str
    calibration_max_age: timedelta
    stiffness: np.ndarray
    damping_ratio: np.ndarray
    limits: SafetyLimits

    def problems(self, facts: RobotFacts | None, now: datetime | None = None) -> list[str]:
        """Why the arm must not be moved, each in one line; empty if it may.

        facts: None of a robot that is under control, and so in order. now: None for the time it is.
        """
        robot = [] if facts is None else [*_mode(facts), *_payload(facts)]
        return [*robot, *self._gains(), *self._calibration(now)]

    def _gains(self) -> list[str]:
        try:
            limit_gains(self.stiffness, self.damping_ratio)
        except Refusal as refusal:
            return [str(refusal)]
        # Sampled damping drives a joint instead of braking it from kd period = 2 inertia on; half of that is
        # the rule.
        pairs = ((self.stiffness, self.damping_ratio), (HOLD_STIFFNESS, HOLD_DAMPING_RATIO))
        most = np.max([damping(*pair) for pair in pairs], axis=0)
        bound = self.limits.inertia / self.limits.period
        return [
            f"gains: {self.limits.joints[i]}: damping {most[i]:.0f} Nms/rad is not stable at "
            f"{1 / self.limits.period:.0f} Hz, expected below {bound[i]:.0f}"
            for i in np.flatnonzero(most >= bound)
        ]

    def _calibration(self, now: datetime | None) -> list[str]:
        if self.calibration == NO_CALIBRATION:
            return []
        if not self.calibration:
            return [
                f"no calibration: name the file that `calibrate` wrote, or `{NO_CALIBRATION}` for a run "
                "without a camera"
            ]
        try:
            calibration.load(self.calibration).require_fresh(self.calibration_max_age, now)
        except calibration.CalibrationError as error:
            return [str(error)]
        return []


def _mode(facts: RobotFacts) -> list[str]:
    if facts.mode == READY_MODE:
        return []
    return [f"the robot's mode is {facts.mode}, expected {READY_MODE} ({facts.errors or 'no errors'})"]


def _payload(facts: RobotFacts) -> list[str]:
    expected = NOMINAL.inertials["hand"].mass
    total = facts.end_effector_mass + facts.load_mass
    if abs(total - expected) > MASS_TOLERANCE or facts.load_mass > MASS_TOLERANCE:
        return [
            f"the robot compensates {facts.end_effector_mass:.2f} kg at its flange and a load of "
            f"{facts.load_mass:.2f} kg, expected the hand's {expected:.2f} kg and no load; set both in "
            "Desk"
        ]
    return []
