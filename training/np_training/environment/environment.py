"""The batched environment: many episodes at once, each from a contact the pre-contact policy chose.

One step is one policy period. Episodes end by success (within tolerance for `hold` steps in a row), a lost object or
the time limit. Worlds that end are placed anew from a pool of starts, drawn from the current pre-contact policy once a
rollout: inverse kinematics and collision checks then cost one large batch instead of many small ones.
"""

from __future__ import annotations

from dataclasses import fields

import torch

from np_description.domains import Task, is_lost, is_success, pose_error
from np_policy import action as actions
from np_policy.observation import normalise_keypoints, post_contact_observation
from np_training.environment import contact
from np_training.environment.config import EnvironmentConfig, force_scale
from np_training.environment.draws import PERIOD, EpisodeDraws
from np_training.environment.object_poses import PRE_STATE_SIZE, canonical_poses, corners, pre_contact_state
from np_training.environment.sight import Sight
from np_training.environment.starts import Starts, miss_contacts
from np_training.environment.view import BatchedView, Past
from np_training.physics.batched import ARM, OBJECT_POSITION, OBJECT_QUATERNION, BatchedPhysics
from np_training.physics.batched_forces import BARE, FINGER, FORCE, RAW, SHARE, SPEED
from np_training.physics.batched_kinematics import forward_kinematics, solve_ik
from np_training.tasks.poses import Poses, quarter_tips
from np_training.tasks.practice import Tasks, draw_tasks
from np_training.tasks.rewards import Measures, PeriodTouch

PRIVILEGED_SIZE = 18 + 6 + 3 + 2


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
        # The pre-contact policy's observation and action for the episode of each world, and the action's probability.
        self.pre_state = torch.zeros(n, PRE_STATE_SIZE, device=device)
        self.pre_action = torch.zeros(n, contact.SIZE, device=device)
        self.pre_log_probability = torch.zeros(n, device=device)
        self.draws = EpisodeDraws(self.physics, self.view.age, self.generator)
        self._past = Past(n, self.view.age / PERIOD, self.device)
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
        """The policy's observation (n, 79), with sensor noise, and the critic's further one (n, 29)."""
        c = self.config.conditions
        q = self.physics.seen_q + c.joint_noise * self._normal(self.config.worlds, 9)
        dq = self.physics.seen_dq + c.velocity_noise * self._normal(self.config.worlds, 9)
        position, rotation = forward_kinematics(q[:, ARM])
        objects, goals = canonical_poses(self.domain, self.objects, self.goals)
        pixels = self.view.keypoints(self._seen_corners(objects)) + self.draws.keypoint_bias
        goal_corners = corners(self.domain, goals)
        goal_pixels = normalise_keypoints(
            self.draws.show_by_camera(c, goal_corners) if c.goal_in_image else goal_corners
        )
        pixels = pixels + c.keypoint_noise * self._normal(self.config.worlds, 16).reshape(-1, 8, 2)
        state = post_contact_observation(q, dq, pixels, goal_pixels, position, rotation, self.last_action)
        remaining = 1 - self.age[:, None] / self.config.limit
        zeta = torch.full_like(remaining, self.limits.position / actions.RESIDUAL_LIMITS_INITIAL.position)
        privileged = torch.cat(
            [pre_contact_state(objects, goals), self.physics.qvel[:, 9:], self.draws.factors, remaining, zeta], -1
        )
        return state, privileged

    def _seen_corners(self, objects: Poses) -> torch.Tensor:
        """Corners (n, 8, 3) m where the camera shows them, for objects as they are seen: as old as the image, and off by as much
        as the camera is off from its nominal pose."""
        points = corners(self.domain, objects)
        points = self._past.at(points, self.draws.image_age) if self._is_late else points
        return self.draws.show_by_camera(self.config.conditions, points)

    @property
    def _is_late(self) -> bool:
        return self.view.age > 0 or self.config.conditions.image_latency != (0.0, 0.0)

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
            miss_contacts(self.domain, self.hand, self.config.conditions, tasks, contacts, self.generator),
            corners(self.domain, tasks.goals),
            quarter_tips(tasks.starts, tasks.goals),
        )

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
        self.draws.draw(self.config.conditions, where, q)
        if self._is_late:
            self._past.begin(self._corners_now(), where)

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
        pressed = peaks[SHARE] > force_scale(config.strictness) * self.draws.force_margin
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
        q, (lower, upper) = self.physics.qpos[:, ARM], self.draws.range
        return (self.physics.over[0] > 0).any(-1) | (q < lower).any(-1) | (q > upper).any(-1)
