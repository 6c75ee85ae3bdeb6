"""Corrections of the camera's calibration and the arm's driver by a patch, before any policy is trained.

They correct a displaced camera, a joint's zero, a load in the hand, a drive's torque offset, dry friction and late images.
These are parameters of the robot's configuration. With the right values, policies meet the conditions that they were trained in.

| effect | corrected in | how |
|---|---|---|
| camera_extrinsics, camera_intrinsics | detector | the object's pose by the true camera, its corners as the nominal one would show them |
| camera_latency | detector | corners are extrapolated over the delay, at their velocity between the last two ticks |
| encoder_bias | driver | subtracted from the reading, and from the angles at which gravity is compensated |
| payload, link_com | driver | gravity of the true arm instead of the nominal one (libfranka: setLoad) |
| torque_offset | driver | subtracted from the command |
| coulomb_friction | driver | FRICTION_SHARE of it is added along the motion, or along the torque where there is none |
| command_delay | driver | the state is predicted to when a command acts, from the commands under way (Smith 1957) |
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
from sim2real.effects.camera_effects import CameraEffects
from sim2real.effects.patch import Patch

from np_control.dynamics import Dynamics
from np_description.camera import CAMERA, Camera
from np_description.domains import Task
from np_perception.pose_estimation import PoseError, estimate_pose, project_keypoints
from np_sim_bridge.schedule import PERIOD, SECOND
from np_sim_bridge.simulation import Measurement

OF_DRIVER = ("encoder_bias", "payload", "link_com", "torque_offset", "coulomb_friction", "command_delay")
OF_CAMERA = ("camera_extrinsics", "camera_intrinsics")
LATENCY = "camera_latency"
_PERIOD = PERIOD / SECOND  # s
FRICTION_SHARE = 0.8  # of friction that is compensated: with more than there is a joint would drive itself
AT_SPEED, AT_TORQUE = 0.02, 0.5  # rad/s, Nm, from which a direction is one
PUSH_TIME = 0.01  # s in which what else accelerates the arm is taken to be the same: contacts, friction
LONGEST = 0.25  # s between two ticks from which corners are carried on


@dataclass(frozen=True)
class Corrections:
    """Corrections of detector and driver."""

    camera: Camera
    """The true camera."""
    delay: float
    """Delay of the images, s."""
    arm: Patch
    """Effects that the driver compensates."""
    remaining: Patch
    """Effects that are not corrected, which policies have to be trained for."""

    @property
    def is_none(self) -> bool:
        """Whether nothing is corrected."""
        return self.camera == CAMERA and self.delay == 0.0 and not self.arm.effects


def corrections(patch: Patch) -> Corrections:
    """The corrections that a patch requires."""
    by = {"camera": [], "arm": [], "delay": [], "remaining": []}
    for effect in patch.effects:
        whose = "camera" if effect.effect in OF_CAMERA else "arm" if effect.effect in OF_DRIVER else "remaining"
        by["delay" if effect.effect == LATENCY else whose].append(effect)
    return Corrections(
        CameraEffects(Patch(tuple(by["camera"]))).camera,
        float(sum(effect.get("delay") for effect in by["delay"])),
        Patch(tuple(by["arm"])),
        Patch(tuple(by["remaining"])),
    )


class CompensatedView:
    """Keypoints of one episode as the nominal camera would show them now. domain: whose object it is."""

    def __init__(self, given: Corrections, domain: Task):
        self._corrections, self._domain = given, domain
        self._last: tuple[int, np.ndarray] | None = None

    def __call__(self, seen: np.ndarray, stamp: int) -> np.ndarray:
        """The corrected keypoints of those (8, 3) u px, v px, score that were found in the image of `stamp` ns."""
        seen = self._reproject(seen)
        if not self._corrections.delay:
            return seen
        last, self._last = self._last, (stamp, seen)
        since = (stamp - last[0]) * 1e-9 if last else 0.0
        if not 0 < since <= LONGEST or not (last[1][:, 2].all() and seen[:, 2].all()):
            return seen
        ahead = seen.copy()
        ahead[:, :2] += (seen - last[1])[:, :2] * (self._corrections.delay / since)
        return ahead

    def _reproject(self, seen: np.ndarray) -> np.ndarray:
        if self._corrections.camera == CAMERA:
            return seen
        try:
            pose = estimate_pose(seen, self._domain, camera=self._corrections.camera).pose
            return np.column_stack([project_keypoints(self._domain, pose)[:, :2], seen[:, 2]])
        except (PoseError, ValueError):  # too few corners, or none in front: what is found is better than nothing
            return seen


class CompensatedArm:
    """A driver with corrections: true joint angles, and the torque that makes the arm follow the command."""

    def __init__(self, given: Corrections):
        arm = given.arm
        self._zero = arm.per_joint("encoder_bias", "bias")
        self._offset = arm.per_joint("torque_offset", "offset")
        self._friction = FRICTION_SHARE * np.maximum(arm.per_joint("coulomb_friction", "level"), 0.0)
        weighs = any(effect.effect in ("encoder_bias", "payload", "link_com") for effect in arm.effects)
        self._weights = (Dynamics(), Dynamics(arm.panda())) if weighs else None
        delay = float(arm.per_joint("command_delay", "delay").max())
        self._ahead = SmithPredictor(delay, Dynamics(arm.panda())) if delay > 0 else None
        self._is_none = not arm.effects

    def read(self, measured: Measurement) -> Measurement:
        """The measurement without encoder bias, predicted to the time at which a command given now acts."""
        if self._is_none:
            return measured
        position, velocity = measured.position.copy(), measured.velocity.copy()
        position[:7] -= self._zero
        if self._ahead is not None:
            position[:7], velocity[:7] = self._ahead(measured.stamp, position[:7], velocity[:7])
        return Measurement(measured.stamp, position, velocity, measured.effort)

    def drive(self, torque: np.ndarray, q: np.ndarray, dq: np.ndarray) -> np.ndarray:
        """Drive command (7,) Nm for `torque` (7,) Nm without gravity. q (7,) rad and dq (7,) rad/s: as from `read`."""
        if self._is_none:
            return torque
        if self._ahead is not None:
            self._ahead.give(torque)
        asked = torque - self._offset
        if self._weights is not None:
            believed, real = self._weights
            asked = asked + real.gravity(q) - believed.gravity(q + self._zero)
        return asked + self._friction * np.tanh(dq / AT_SPEED + torque / AT_TORQUE)


class SmithPredictor:
    """An arm's state after the delay of its commands: those that are under way act on its inertia, and what else accelerates it goes on.

    Without the second a joint that presses against something would be predicted to move, and give way by that. delay: s.
    """

    def __init__(self, delay: float, dynamics: Dynamics):
        whole, part = divmod(delay / _PERIOD, 1.0)
        # Of the commands under way the oldest acts for a part of a period more.
        self._times = np.array([part, *[1.0] * int(whole)]) * _PERIOD
        self._part, self._dynamics = part, dynamics
        self._given: deque[np.ndarray] = deque([np.zeros(7)] * (int(whole) + 2), maxlen=int(whole) + 2)
        self._else = np.zeros(7)  # rad/s^2
        self._last: tuple[int, np.ndarray] | None = None
        self._found: tuple[np.ndarray, np.ndarray] | None = None

    def give(self, torque: np.ndarray) -> None:
        """A command (7,) Nm without gravity, that is sent on now."""
        self._given.append(np.array(torque))

    def __call__(self, stamp: int, q: np.ndarray, dq: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """q (7,) rad, dq (7,) rad/s after the delay, of those at `stamp` ns; a second call for a stamp returns the same."""
        if self._last is not None and stamp == self._last[0]:
            return self._found
        inverse = np.linalg.inv(self._dynamics.mass_matrix(q))
        given = np.array(self._given)
        if self._last is not None and stamp == self._last[0] + PERIOD:
            acted = (1 - self._part) * given[1] + self._part * given[0]  # in the period that has gone by
            self._else += (
                ((dq - self._last[1]) / _PERIOD - inverse @ acted - self._else) * _PERIOD / (PUSH_TIME + _PERIOD)
            )
        self._last = stamp, dq.copy()
        for torque, time in zip(given[1:], self._times):
            faster = dq + (inverse @ torque + self._else) * time
            q, dq = q + (dq + faster) / 2 * time, faster
        self._found = q, dq
        return self._found
