"""The approach: from where the arm is to the pre-contact pose.

The pre-contact pose touches the object, so no collision-free path ends there. The motion has up to three parts. It goes
straight away from whatever the hand touches at the start, then by a collision-free path to a stand-off in front of the
object, and then slowly straight to the pose. Only on the straight parts, and only hand and fingers, may be in contact.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from np_common.rotations import matrix_from_quaternion
from np_control.kinematics import forward_kinematics, pose_distance, solve_ik
from np_control.trajectory import Trajectory
from np_description.domains import Pose
from np_description.scene import OBJECT
from np_planning.collision import CloseBodies, CollisionModel
from np_planning.rrt import PlanningBudget, PlanningError, find_path
from np_planning.stand_off import retreat
from np_planning.time_parametrization import ACCELERATION_LIMIT, join_trajectories, parametrize_path, round_corners


class UnreachableError(PlanningError):
    """No posture of the arm puts the hand at the pose as it must be put."""


class StartError(PlanningError):
    """The arm cannot leave the posture it is in."""


@dataclass(frozen=True)
class ApproachConfig:
    """Parameters of the approach; m, s, rad.

    standoff: length of the straight parts; object_depth, surface_depth: how far hand and fingers may reach into the
    object's estimated pose and into fixed surroundings on these parts, for estimates are not exact; largest_lift: a pose that reaches
    deeper into the table is raised by up to this much; contact_speed: of the hand on the straight parts, m/s;
    velocity, acceleration: shares of the robot's limits; postures: inverse kinematics solutions looked for;
    limit_margin: distance kept from joint limits; resolution: between postures checked. With a clearance of 5 mm and
    0.9 m of reach, postures 0.01 rad apart leave no room for a contact between them.
    """

    standoff: float = 0.05
    object_depth: float = 0.015
    surface_depth: float = 0.002
    largest_lift: float = 0.02
    contact_speed: float = 0.08
    velocity: float = 0.4
    acceleration: float = 0.2
    postures: int = 24
    limit_margin: float = 0.05
    resolution: float = 0.01
    budget: PlanningBudget = field(default_factory=PlanningBudget)


@dataclass(frozen=True)
class ApproachPlan:
    """trajectory: the whole motion; lift: m by which the pose was raised out of the surroundings; penetration_retreat: m by which it was drawn
    out of the object; contact_start: s at which the last straight part begins."""

    trajectory: Trajectory
    lift: float
    contact_start: float
    penetration_retreat: float = 0.0


_POSITION_TOLERANCE, _ANGLE_TOLERANCE = 5e-4, 2e-3  # m, rad: when inverse kinematics has arrived
_LINE_STEP = 0.0025  # m
_CANDIDATES = 6  # goal postures that are tried in turn


def plan_approach(
    collision: CollisionModel,
    joints,
    goal: Pose,
    opening: float,
    object_pose: Pose,
    *,
    seed: int,
    config: ApproachConfig = ApproachConfig(),
) -> ApproachPlan:
    """Plan from joints (7,) rad to the hand pose `goal` (T_E in the base frame).

    opening: of each finger, m; object_pose: estimated pose of the object in the base frame. Equal arguments give equal
    results, unless config.budget names seconds. Raises StartError, UnreachableError, or PlanningError where there is
    no path, each with the reason.
    """
    joints = np.asarray(joints, float)
    collision.place(object_pose, opening)
    hand = _Hand(collision, config)
    leave = _leave_start(hand, joints)
    reason: PlanningError | None = None
    position = np.asarray(goal.position, float)
    postures = hand.postures(position, goal.quaternion, joints, seed)
    out = hand.penetration_retreat(postures[0], object_pose, goal, opening)
    if out.any():
        position = position + out
        postures = hand.postures(position, goal.quaternion, joints, seed)
    lift = hand.table_clearance(postures[0])
    if lift > 0:
        postures = hand.postures(position + np.array([0.0, 0.0, lift]), goal.quaternion, joints, seed)
    for posture in postures[:_CANDIDATES]:
        try:
            arrive = hand.straight_retreat(posture)[::-1]
            lower, upper = hand.bounds(leave[-1], arrive[0])
            path = find_path(
                collision.is_free,
                leave[-1],
                arrive[0],
                lower,
                upper,
                seed=seed,
                budget=config.budget,
                resolution=config.resolution,
            )
            return replace(
                _timed(collision, leave, path, arrive, lift, config), penetration_retreat=float(np.linalg.norm(out))
            )
        except PlanningError as error:
            reason = reason or error  # of the most natural posture
    raise reason


def _leave_start(hand: _Hand, joints) -> np.ndarray:
    """Postures (n, 7) from `joints` to a free one: n = 1 if it is free."""
    panda = hand.collision.panda
    outside = (joints < panda.position_lower) | (joints > panda.position_upper)
    if outside.any():
        raise StartError(
            f"start: expected joints within limits, joint {int(outside.argmax()) + 1} is at "
            f"{joints[outside.argmax()]:.3f} rad"
        )
    if hand.collision.is_free(joints):
        return joints[None]
    try:
        return hand.straight_retreat(joints)
    except UnreachableError as error:
        raise StartError(f"start: the arm cannot get clear: {error}") from error


def _timed(collision: CollisionModel, leave, path, arrive, lift: float, config: ApproachConfig) -> ApproachPlan:
    velocity = config.velocity * collision.panda.velocity_limit
    acceleration = config.acceleration * ACCELERATION_LIMIT

    def slowly(line):
        fast = parametrize_path(line, velocity, acceleration)
        points, _ = forward_kinematics(fast.positions)
        speed = np.linalg.norm(np.diff(points, axis=0), axis=1) / np.diff(fast.times)
        share = min(1.0, config.contact_speed / speed.max())
        return Trajectory(fast.times / share, fast.positions, fast.velocities * share)

    parts = [slowly(leave)] if len(leave) > 1 else []
    if np.linalg.norm(path[-1] - path[0]) > 1e-6:
        parts.append(parametrize_path(round_corners(path, collision.is_free), velocity, acceleration))
    parts.append(slowly(arrive))
    whole = parts[0]
    for part in parts[1:]:
        whole = join_trajectories(whole, part)
    return ApproachPlan(whole, lift, whole.duration - parts[-1].duration)


class _Hand:
    """Inverse kinematics and the rules of contact."""

    def __init__(self, collision: CollisionModel, config: ApproachConfig) -> None:
        self.collision, self.config = collision, config
        panda = collision.panda
        self._lower, self._upper = (
            panda.position_lower + config.limit_margin,
            panda.position_upper - config.limit_margin,
        )

    def postures(self, position, quaternion, joints, seed: int) -> np.ndarray:
        """Solutions (n, 7), n >= 1, of inverse kinematics: from the posture the arm is in, from ready, then others,
        the nearest to `joints` first. Raises UnreachableError."""
        panda = self.collision.panda
        rotation = matrix_from_quaternion(quaternion)
        others = np.random.default_rng(seed).uniform(self._lower, self._upper, (self.config.postures, 7))
        seeds = np.concatenate([joints[None], panda.ready[None], others])
        found = solve_ik(seeds, position, rotation, iterations=80, panda=panda)
        distance, angle = pose_distance(found, position, rotation, panda)
        arrived = (distance < _POSITION_TOLERANCE) & (angle < _ANGLE_TOLERANCE)
        if not arrived.any():
            raise UnreachableError(
                f"unreachable: no posture brings the hand to {_text(position)} m with this "
                f"orientation, the nearest misses by {distance.min() * 1e3:.1f} mm"
            )
        inside = arrived & ((found > self._lower) & (found < self._upper)).all(axis=1)
        if not inside.any():
            raise UnreachableError(
                f"unreachable: every posture with the hand at {_text(position)} m has a joint "
                f"within {self.config.limit_margin:g} rad of its limit"
            )
        order = np.linalg.norm(found - joints, axis=1)
        order[:2] -= 100.0, 50.0  # where the arm already is, or usually is: the policies were trained there
        return found[np.argsort(np.where(inside, order, np.inf), kind="stable")][: inside.sum()]

    def bounds(self, *postures) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper joint positions (7,) of the motion: limits with their margin, unless it begins beyond that."""
        return np.min([self._lower, *postures], axis=0), np.max([self._upper, *postures], axis=0)

    def penetration_retreat(self, joints, object_pose: Pose, goal: Pose, opening: float) -> np.ndarray:
        """The way (3,) m out of the object (`stand_off.retreat`) of a hand that would touch it at joints (7,) rad; zeros where none would.

        A student misses its teacher's contact by some millimetres, and where none of its training began, by more.
        """
        touches = self.collision.touches(joints)
        if not any(t.distance < 0 and t.by_tool and OBJECT in (t.first, t.second) for t in touches):
            return np.zeros(3)
        rotation = matrix_from_quaternion(goal.quaternion)
        return retreat(
            self.collision.domain, object_pose.position, object_pose.quaternion, goal.position, rotation, opening
        )

    def table_clearance(self, joints) -> float:
        """How far m the hand has to be raised so that it is no deeper in fixed surroundings than it may be."""
        depths = [
            -touch.distance - self.config.surface_depth
            for touch in self.collision.touches(joints)
            if touch.by_tool and OBJECT not in (touch.first, touch.second)
        ]
        lift = max(depths, default=0.0)
        if lift > self.config.largest_lift:
            raise UnreachableError(
                f"unreachable: the hand would be {(lift + self.config.surface_depth) * 1e3:.1f} mm "
                "deep in the surroundings"
            )
        return max(0.0, lift)

    def straight_retreat(self, joints) -> np.ndarray:
        """Postures (n, 7) along a straight line of the hand from `joints` to a free posture; the first is `joints`.

        Tried: back along the fingers, up, and between the two. Raises UnreachableError with what is in the way.
        """
        position, rotation = forward_kinematics(joints)
        up = np.array([0.0, 0.0, 1.0])
        directions = [-rotation[:, 2], up - rotation[:, 2], up]
        first: UnreachableError | None = None
        for direction in directions:
            length = np.linalg.norm(direction)
            if length < 1e-3:
                continue
            try:
                return self._line(joints, position, rotation, direction / length)
            except UnreachableError as error:
                first = first or error
        raise first

    def _line(self, joints, position, rotation, direction) -> np.ndarray:
        panda, line = self.collision.panda, [np.asarray(joints, float)]
        self._check_contact(line[0])
        count = int(np.ceil(self.config.standoff / _LINE_STEP))
        for i in range(1, count + 1):
            at = position + direction * (self.config.standoff * i / count)
            nearby = solve_ik(line[-1], at, rotation, iterations=10, panda=panda)
            distance, angle = pose_distance(nearby, at, rotation, panda)
            if distance > _POSITION_TOLERANCE or angle > _ANGLE_TOLERANCE:
                raise UnreachableError(f"unreachable: the hand cannot back off straight beyond {_text(at)} m")
            self._check_contact(nearby)
            line.append(nearby)
        blocked = self.collision.touches(line[-1])
        if blocked:
            raise UnreachableError(f"unreachable: {blocked[0]} at the stand-off")
        return np.stack(line)

    def _check_contact(self, joints) -> None:
        for touch in self.collision.touches(joints):
            if touch.distance < 0 and touch.distance < -self._allowed(touch):
                raise UnreachableError(f"unreachable: {touch}")

    def _allowed(self, touch: CloseBodies) -> float:
        if not touch.by_tool:
            return 0.0
        is_object = OBJECT in (touch.first, touch.second)
        return self.config.object_depth if is_object else self.config.surface_depth + 1e-4


def _text(position) -> str:
    return "(" + ", ".join(f"{value:.3f}" for value in position) + ")"
