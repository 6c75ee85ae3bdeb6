"""The batched environment: many episodes at once, each from a contact the pre-contact policy chose.

One step is one policy period. Episodes end by success (within tolerance for `hold` steps in a row), a lost object or
the time limit. Worlds that end are placed anew from a pool of starts, drawn from the current pre-contact policy once a
rollout: inverse kinematics and collision checks then cost one large batch instead of many small ones.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
import torch

from np_common.rotations import matrix_from_quaternion, matrix_from_vector, quaternion_multiply, six_from_matrix
from np_control.impedance import DAMPING_RATIO_MIN
from np_description.camera import CAMERA
from np_description.domains import Task, is_lost, is_success, pose_error
from np_description.keypoints import box_keypoints
from np_description.panda import NOMINAL
from np_description.symmetry import canonical_rotation, symmetries
from np_policy import action as actions
from np_policy.observation import normalised_keypoints, post_contact_observation
from np_training.environment import contact
from np_training.environment.sight import Sight
from np_training.environment.starts import Starts
from np_training.environment.view import BatchedView, Past
from np_training.physics.batched import ARM, OBJECT_POSITION, OBJECT_QUATERNION, BatchedPhysics
from np_training.physics.batched_forces import BARE, FINGER, FORCE, RAW, SHARE, SPEED
from np_training.physics.batched_kinematics import forward_kinematics, solve_ik
from np_training.physics.config import PhysicsConfig
from np_training.tasks.poses import Poses, quarter_tips
from np_training.tasks.practice import Tasks, draw_tasks
from np_training.tasks.randomisation import DELAY_STEP, NOMINAL_CONDITIONS, Conditions
from np_training.tasks.rewards import Measures, PeriodTouch, RewardConfig

PRE_STATE_SIZE = 18
PERIOD = 1 / actions.RATE  # s
START_SLACK = 0.1  # rad, between where an episode begins and the range that is allowed in it
PRIVILEGED_SIZE = 18 + 6 + 3 + 2
LOOSE_FORCE = 10.0  # times the force reflex's thresholds at strictness 0: what an untrained policy's blows come to


@dataclass(frozen=True)
class EnvironmentConfig:
    """worlds; limit: steps an episode; hold: steps within tolerance, a share of the domain's, that count as success; seed;
    shares: of each kind of task (`TaskConfig.kinds`), the domain's own first; explore: share of contacts at any point of the object,
    which the pre-contact policy did not choose; reflex: whether a joint beyond its limits of speed or position ends the episode, as
    the robot's own reflex does (`np_sim_bridge` reports a fault there); strictness: 0 where learning begins, 1 where it ends: how much of
    the prices on touches is charged, and how near the force reflex is to the robot's (`force_scale`); damping_floor: least damping ratio
    of an action."""

    worlds: int = 24576
    limit: int = 100
    hold: int = 1
    tolerance: float = 1.0
    seed: int = 0
    shares: tuple[float, ...] = (1.0,)
    explore: float = 0.0
    reflex: bool = False
    force_reflex: bool = True
    strictness: float = 1.0
    damping_floor: float = DAMPING_RATIO_MIN
    reward: RewardConfig = RewardConfig()
    physics: PhysicsConfig = PhysicsConfig()
    conditions: Conditions = NOMINAL_CONDITIONS


def pre_contact_state(objects: Poses, goals: Poses) -> torch.Tensor:
    """The pre-contact policy's input (n, 18): object and goal, position scaled and 6D rotation."""

    def encode(poses: Poses) -> torch.Tensor:
        centre = torch.tensor([0.5, 0.0, 0.0], device=poses.position.device)
        return torch.cat(
            [(poses.position - centre) / 0.2, six_from_matrix(matrix_from_quaternion(poses.quaternion))], -1
        )

    return torch.cat([encode(objects), encode(goals)], -1)


def force_scale(strictness: float) -> float:
    """Factor of the force reflex's thresholds, geometric from LOOSE_FORCE at 0 to 1 at 1, as the residual limits tighten."""
    return LOOSE_FORCE ** (1 - strictness)


def canonical_poses(domain: Task, objects: Poses, goals: Poses) -> tuple[Poses, Poses]:
    """Poses of objects and goals (n,) under the names of their faces that the policies see (np_description.symmetry)."""
    if not domain.interchangeable:
        return objects, goals
    turns = torch.tensor(symmetries(domain.half_size), dtype=goals.position.dtype, device=goals.position.device)
    turn = turns[canonical_rotation(domain, normalised_keypoints(corners(domain, goals)))]
    axes = matrix_from_quaternion(turn).abs()  # which of the old edges lies along each of the new axes
    return tuple(
        Poses(
            p.position,
            quaternion_multiply(p.quaternion, turn),
            None if p.scale is None else (p.scale[:, :, None] * axes).sum(1),
        )
        for p in (objects, goals)
    )


def corners(domain: Task, poses: Poses) -> torch.Tensor:
    """Corners (n, 8, 3) m of the domain's object at poses (n,)."""
    return box_keypoints(poses.half_size(domain), poses.position, poses.quaternion)


class Environment:
    """`config.worlds` episodes of a domain on one device."""

    def __init__(self, domain: Task, device: str, config: EnvironmentConfig = EnvironmentConfig()) -> None:
        self.domain, self.config, self.device = domain, config, torch.device(device)
        self.physics = BatchedPhysics(domain, config.worlds, device, config.physics)
        self.hand = config.physics.contact.hand
        self.sight = Sight(self.physics.host_model, device)
        self.view = BatchedView(config.physics.effects)
        self.generator = torch.Generator(device=device).manual_seed(config.seed)
        self.limits = actions.RESIDUAL_LIMITS_INITIAL
        n = config.worlds
        self.goals = Poses(
            torch.zeros(n, 3, device=device), torch.zeros(n, 4, device=device), self.physics.varied.scale
        )
        self.goal_corners = torch.zeros(n, 8, 3, device=device)
        self.last_action = torch.zeros(n, actions.SIZE, device=device)
        self.age = torch.zeros(n, dtype=torch.long, device=device)
        self.held = torch.zeros(n, dtype=torch.long, device=device)
        self.total = torch.zeros(n, device=device)
        self.kind = torch.zeros(n, dtype=torch.long, device=device)  # of task: index into the task's kinds
        self.tips = torch.zeros(
            n, dtype=torch.long, device=device
        )  # quarter turns from the start's upper face to the goal's
        # What the pre-contact policy saw and did for the episode of each world, and how probable it was.
        self.pre_state = torch.zeros(n, PRE_STATE_SIZE, device=device)
        self.pre_action = torch.zeros(n, contact.SIZE, device=device)
        self.pre_log_probability = torch.zeros(n, device=device)
        self.keypoint_bias = torch.zeros(n, 1, 2, device=device)
        self.image_age = torch.zeros(n, 1, 1, device=device)  # policy periods
        self._past = Past(n, self.view.age / PERIOD, self.device)
        # How the camera sees the base frame turned and shifted about its own place.
        self.camera_turn = torch.eye(3, device=device).repeat(n, 1, 1)
        self.camera_shift = torch.zeros(n, 1, 3, device=device)
        self.conditions = torch.ones(n, 3, device=device)  # factors of table friction, finger friction, mass
        # Joint range (2, n, 7) rad beyond which the reflex ends an episode.
        self._mechanical = torch.tensor(
            np.stack([NOMINAL.position_lower, NOMINAL.position_upper]), dtype=torch.float32, device=device
        )
        self.range = self._mechanical[:, None].repeat(1, n, 1)
        self.force_margin = torch.ones(n, device=device)  # share of the force reflex's thresholds
        self.force = torch.zeros(2, n, device=device)  # N: the episode's largest filtered and raw force
        self.starts: Starts | None = None

    # --- state ---------------------------------------------------------------------------------------------------

    @property
    def objects(self) -> Poses:
        """Object poses now."""
        physics = self.physics
        return Poses(physics.qpos[:, OBJECT_POSITION], physics.qpos[:, OBJECT_QUATERNION], physics.varied.scale)

    def measure(self) -> Measures:
        """How far the episodes are from their goals now."""
        objects = self.objects
        distance, angle = pose_error(objects.position, objects.quaternion, self.goals.position, self.goals.quaternion)
        apart = (corners(self.domain, objects) - self.goal_corners).norm(dim=-1)
        if self.domain.tolerance_angle is None:
            angle = torch.zeros_like(angle)
        else:
            distance = apart.mean(-1)
        hand, _ = forward_kinematics(self.physics.qpos[:, ARM])
        return Measures(distance, angle, (hand - objects.position).norm(dim=-1), apart)

    def observe(self) -> tuple[torch.Tensor, torch.Tensor]:
        """What the policy sees (n, 79), with sensor noise, and what only the critic sees beside it (n, 29)."""
        c = self.config.conditions
        q = self.physics.seen_q + c.joint_noise * self._normal(self.config.worlds, 9)
        dq = self.physics.seen_dq + c.velocity_noise * self._normal(self.config.worlds, 9)
        position, rotation = forward_kinematics(q[:, ARM])
        objects, goals = canonical_poses(self.domain, self.objects, self.goals)
        pixels = self.view.keypoints(self._seen_corners(objects)) + self.keypoint_bias
        goal_corners = corners(self.domain, goals)
        goal_pixels = normalised_keypoints(self._by_camera(goal_corners) if c.goal_in_image else goal_corners)
        pixels = pixels + c.keypoint_noise * self._normal(self.config.worlds, 16).reshape(-1, 8, 2)
        state = post_contact_observation(q, dq, pixels, goal_pixels, position, rotation, self.last_action)
        remaining = 1 - self.age[:, None] / self.config.limit
        zeta = torch.full_like(remaining, self.limits.position / actions.RESIDUAL_LIMITS_INITIAL.position)
        privileged = torch.cat(
            [pre_contact_state(objects, goals), self.physics.qvel[:, 9:], self.conditions, remaining, zeta], -1
        )
        return state, privileged

    def _seen_corners(self, objects: Poses) -> torch.Tensor:
        """Corners (n, 8, 3) m where the camera shows them, for objects as they are seen: as old as the image, and off by as much
        as the camera is off from where it is said to be."""
        points = corners(self.domain, objects)
        return self._by_camera(self._past.at(points, self.image_age) if self._is_late else points)

    @property
    def _is_late(self) -> bool:
        return self.view.age > 0 or self.config.conditions.image_latency != (0.0, 0.0)

    def _by_camera(self, points: torch.Tensor) -> torch.Tensor:
        """Points (n, k, 3) m where a camera that is off shows them to who takes it to be where it is said to be."""
        c = self.config.conditions
        if c.camera_position or c.camera_rotation:
            place = torch.tensor(CAMERA.position, dtype=points.dtype, device=points.device)
            points = (points - place) @ self.camera_turn.transpose(1, 2) + place + self.camera_shift
        return points

    def _corners_now(self) -> torch.Tensor:
        objects, _ = canonical_poses(self.domain, self.objects, self.goals)
        return corners(self.domain, objects)

    def _normal(self, rows: int, columns: int) -> torch.Tensor:
        return torch.randn(rows, columns, generator=self.generator, device=self.device)

    # --- starts --------------------------------------------------------------------------------------------------

    def draw_starts(self, pre_policy, count: int) -> Starts:
        """A pool of `count` tasks with the contacts that `pre_policy.act(state, explore)` -> (action, log p) chooses."""
        conditions = self.config.conditions
        tasks = draw_tasks(self.domain, self.config.shares, count, self.generator, conditions.size)
        state = pre_contact_state(*canonical_poses(self.domain, tasks.starts, tasks.goals))
        action, log_probability = pre_policy.act(state, self.config.explore)
        contacts = contact.resolve(self.domain, action, tasks.starts, tasks.sunk, self.hand)
        return self.pool(tasks, state, action, log_probability, contacts)

    def pool(
        self,
        tasks: Tasks,
        state: torch.Tensor,
        action: torch.Tensor,
        log_probability: torch.Tensor,
        contacts: contact.Contacts,
    ) -> Starts:
        """The pool of these starts (n,), under the conditions now, with all that a reset would else work out for a few."""
        return Starts(
            tasks,
            state,
            action,
            log_probability,
            contacts,
            self._missed(tasks, contacts),
            corners(self.domain, tasks.goals),
            quarter_tips(tasks.starts, tasks.goals),
        )

    def _missed(self, tasks: Tasks, contacts: contact.Contacts) -> torch.Tensor:
        """Joints (n, 7) rad where approaches to the contacts end: the approach of the real robot, and the student, miss the
        teacher's pose by a little."""
        n, c = len(contacts.q), self.config.conditions
        if not (c.start_position or c.start_rotation):
            return contacts.q
        shift = c.start_position * (2 * torch.rand(n, 3, generator=self.generator, device=self.device) - 1)
        shift[:, 2] = shift[:, 2].abs()
        turn = matrix_from_vector(c.start_rotation * self._normal(n, 3))
        missed = solve_ik(contacts.q, contacts.position + shift, turn @ contacts.rotation)
        free = contact.gripper_clearance(self.domain, missed, contacts.width, tasks.starts, tasks.sunk, self.hand) > 0
        return torch.where(free[:, None], missed, contacts.q)

    def reset(self, where: torch.Tensor) -> None:
        """Begin new episodes in the worlds `where` (n,), from the pool of starts."""
        n = len(where)
        if n == 0:
            return
        starts = self.starts
        row, tasks = starts.take(n), starts.tasks
        objects, goals, q = tasks.starts[row], tasks.goals[row], starts.q[row]
        width = starts.contacts.width[row][:, None].expand(n, 2)
        self.physics.place(where, torch.cat([q, width, objects.position, objects.quaternion], -1), tasks.sunk[row])
        if self.config.physics.resizes:
            self.physics.varied.resize(
                where, torch.ones_like(objects.position) if objects.scale is None else objects.scale
            )
        self.physics.fingers[where] = width
        self.physics.hold(where, q)
        self.goals.position[where], self.goals.quaternion[where] = goals.position, goals.quaternion
        self.goal_corners[where] = starts.goal_corners[row]
        self.last_action[where] = 0
        self.age[where] = 0
        self.held[where] = 0
        self.total[where] = 0
        self.force[:, where] = 0
        self.kind[where] = tasks.kind[row]
        self.tips[where] = starts.tips[row]
        self.pre_state[where], self.pre_action[where] = starts.state[row], starts.action[row]
        self.pre_log_probability[where] = starts.log_probability[row]
        self._draw_conditions(where, q)
        if self._is_late:
            self._past.begin(self._corners_now(), where)

    def _draw_conditions(self, where: torch.Tensor, q: torch.Tensor) -> None:
        c, n = self.config.conditions, len(where)
        delay = torch.randint(c.delay[0], c.delay[1] + 1, (n,), generator=self.generator, device=self.device)
        self.physics.delay[where] = (delay * round(DELAY_STEP / self.config.physics.timestep)).int()
        self.keypoint_bias[where] = c.keypoint_bias * self._normal(n, 2)[:, None]
        if c.randomises_physics:
            factors = [
                self._uniform(n, *c.table_friction),
                self._uniform(n, *c.finger_friction),
                self._factor(n, c.mass),
            ]
            self.conditions[where] = torch.stack(factors, -1)
            self.physics.varied.randomise(where, *factors, self._uniform(n, *c.housing_friction))
            ranges = (c.stiffness, c.damping, c.time_constant, c.friction_stiffness)
            self.physics.varied.stiffen(where, *(self._factor(n, ends) for ends in ranges))
            worn = (c.joint_friction, c.joint_damping, c.armature)
            self.physics.varied.wear(where, *(self._factor(7 * n, ends).reshape(n, 7) for ends in worn))
            self.physics.varied.shift_centre(where, c.centre * self._uniform(3 * n, -1.0, 1.0).reshape(n, 3))
        if c.finger_length or c.finger_tilt:
            length, turn = (self._uniform(k * n, -1.0, 1.0).reshape(n, 2, -1) for k in (2, 6))
            turn[..., 2] = 0  # about its sides, not about the finger
            self.physics.varied.bend(where, c.finger_length * length[..., 0], c.finger_tilt * turn)
        if c.support is not None:
            self.physics.varied.support(where, self._uniform(3 * n, *c.support).reshape(n, 3))
        if c.camera_position or c.camera_rotation:
            self.camera_turn[where] = matrix_from_vector(c.camera_rotation * self._normal(n, 3))
            self.camera_shift[where] = c.camera_position * self._normal(n, 3)[:, None]
        self.image_age[where] = (self.view.age + self._uniform(n, *c.image_latency)[:, None, None]) / PERIOD
        self.force_margin[where] = self._uniform(n, *c.force_margin)
        self._draw_limits(where, q, self._uniform(n, *c.limit_margin))

    def _draw_limits(self, where: torch.Tensor, q: torch.Tensor, margin: torch.Tensor) -> None:
        """Let the reflex come at shares `margin` (n,) of the limits; where an episode begins at q (n, 7) rad is within them."""
        self.physics.margin[where] = margin
        lower, upper = self._mechanical
        middle, half = (lower + upper) / 2, (upper - lower) / 2 * margin[:, None]
        self.range[0, where] = torch.minimum(middle - half, q - START_SLACK).maximum(lower)
        self.range[1, where] = torch.maximum(middle + half, q + START_SLACK).minimum(upper)

    def _uniform(self, count: int, low: float, high: float) -> torch.Tensor:
        return low + (high - low) * torch.rand(count, generator=self.generator, device=self.device)

    def _factor(self, count: int, ends: tuple[float, float]) -> torch.Tensor:
        """(count,) numbers drawn evenly in their logarithm."""
        return torch.exp(self._uniform(count, *np.log(ends)))

    # --- step ----------------------------------------------------------------------------------------------------

    def step(self, action: torch.Tensor) -> dict[str, torch.Tensor]:
        """Advance every world by one policy period under actions (n, 20).

        Returns reward, done, success, lost, stopped (by the reflex), pressed (of these, by its forces), timeout (n,), hidden
        (`Sight.hidden`), touch (`PeriodTouch`), share (n,) of the force reflex's thresholds, the reward's terms, and for ended episodes their total.
        Ended worlds are NOT reset: call `reset(done.nonzero())`, after the critic has seen the last state.
        """
        physics, config = self.physics, self.config
        before = self.measure()
        if self._is_late:
            self._past.remember(self._corners_now())
        q = physics.seen_q[:, ARM].clone()
        position, rotation = forward_kinematics(q)
        target = actions.decode(action, position, rotation, self.limits, config.damping_floor)
        physics.aim(solve_ik(q, target.position, target.rotation), target)
        physics.noise.copy_(config.conditions.torque_noise * self._normal(config.worlds, 7))
        physics.advance()
        change = action[:, actions.POSE].clamp(-1, 1) - self.last_action[:, actions.POSE]
        self.last_action = action.clamp(-1, 1)
        self.age += 1
        objects = self.objects
        broken = ~torch.isfinite(physics.qpos).all(-1)
        distance, angle = pose_error(objects.position, objects.quaternion, self.goals.position, self.goals.quaternion)
        self.held = torch.where(is_success(self.domain, distance, angle, config.tolerance), self.held + 1, 0)
        peaks = physics.forces.peaks.nan_to_num(nan=0.0)
        self.force = self.force.maximum(peaks[: RAW + 1])
        pressed = peaks[SHARE] > force_scale(config.strictness) * self.force_margin
        if not config.force_reflex:
            pressed = torch.zeros_like(broken)
        stopped = (self._stopped() if config.reflex else torch.zeros_like(broken)) | pressed
        success = (self.held >= config.hold) & ~stopped
        lost = (is_lost(self.domain, objects.position) | broken) & ~success & ~stopped
        timeout = (self.age >= config.limit) & ~success & ~lost & ~stopped
        after = self.measure()
        # A world whose numbers are none is where it was before.
        pairs = ((getattr(before, f.name), getattr(after, f.name)) for f in fields(Measures))
        after = Measures(*(torch.where(broken.view(-1, *[1] * (old.ndim - 1)), old, new) for old, new in pairs))
        touched = physics.forces.touched > 0
        touch = PeriodTouch(peaks[FORCE], peaks[SPEED], touched[BARE], touched[FINGER], config.strictness)
        hidden = self.sight.hidden(*physics.geoms, objects, corners(self.domain, objects)).nan_to_num()
        terms = config.reward.terms(before, after, success, lost | stopped, target.stiffness, touch, change, hidden)
        reward = sum(terms.values())
        self.total += reward
        return {
            "reward": reward,
            "done": success | lost | stopped | timeout,
            "success": success,
            "lost": lost,
            "stopped": stopped,
            "pressed": pressed,
            "touch": touch,
            "share": peaks[SHARE],
            "timeout": timeout,
            "terms": terms,
            "distance": distance,
            "angle": angle,
            "broken": broken,
            "hidden": hidden,
        }

    def _stopped(self) -> torch.Tensor:
        """Worlds (n,) in which a joint was too fast in the last period, or is outside its range."""
        q, (lower, upper) = self.physics.qpos[:, ARM], self.range
        return (self.physics.over[0] > 0).any(-1) | (q < lower).any(-1) | (q > upper).any(-1)
