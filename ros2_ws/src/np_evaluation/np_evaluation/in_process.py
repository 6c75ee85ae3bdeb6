"""Episodes without a graph: simulated robot, guards, controller, planner, policies and the phases of an episode in one process.

One takes 1 to 4 s of processor time with true corners, 2 to 8 with images, where eight nodes take 20 to 70. It calls what the
nodes call, in the same order, without messages. An episode is not the graph's bit for bit: contacts amplify the last digit.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from sim2real.effects.camera_effects import CameraEffects
from sim2real.effects.patch import Patch

from np_control.controller import Controller
from np_control.safety import Refusal, SafetyFilter
from np_description.camera import CAMERA
from np_description.control_rate import SECOND
from np_description.domains import Task
from np_description.engine import MakeEngine
from np_description.force_reflex import DEFAULT_MODE
from np_description.mujoco_engine import MujocoEngine
from np_description.panda import JOINT_NAMES
from np_description.phases import FAULT, POST, PRE, PhaseState
from np_evaluation.calibration_corrections import CompensatedArm, CompensatedView, corrections
from np_evaluation.scoring import Result, engine_version, result_of
from np_perception.occluded_keypoints import OccludedKeypointBuffer
from np_perception.pose_estimation import PoseError, estimate_pose, project_keypoints
from np_planning.approach import plan_approach
from np_planning.collision import CollisionModel
from np_planning.rrt import PlanningError
from np_policy.action import PolicyError
from np_policy.contract import POST_CONTACT, PRE_CONTACT, weights_file
from np_policy.episode import Episode, Event
from np_policy.episode_config import EpisodeConfig
from np_policy.policy import PostContactPolicy, PreContactPolicy
from np_record.outcome import score_outcome
from np_sim_bridge.simulation import Simulation

TICK = SECOND // 10  # ns
IMAGE = SECOND // 30  # ns


def find_engine(name: str) -> MakeEngine:
    """The engine mujoco or physx. Raises OSError where the second is not installed."""
    if name == "mujoco":
        return MujocoEngine
    from np_physx_bridge.engine import PhysxEngine

    return PhysxEngine


class InProcessRollout:
    """A domain's graph as one object.

    patch: effects of arm, scene and view, without which policies and planner compute; corrected: the effects that detector and driver
    correct (`np_evaluation.calibration_corrections`); weights: folder, "" for the project's own; force_reflex: stop or observe.
    """

    def __init__(
        self,
        domain: Task,
        engine: str,
        *,
        seed: int = 0,
        contacts: int = 1,
        patch: Patch = Patch(),
        corrected: Patch = Patch(),
        weights: str | Path = "",
        force_reflex: str = DEFAULT_MODE,
    ):
        self._corrections = corrections(corrected)
        self._domain, self._seed, self._contacts, self._patch = domain, seed, contacts, patch
        self._engine, self._force_reflex = find_engine(engine), force_reflex
        self._engine_named = {"engine": engine, "engine_version": engine_version(engine)}
        self._pre = PreContactPolicy(weights_file(PRE_CONTACT, domain, weights), domain)
        self._post = PostContactPolicy(weights_file(POST_CONTACT, domain, weights), domain)
        self._collision = CollisionModel(domain)

    @property
    def domain(self) -> Task:
        """The task of the episodes."""
        return self._domain

    def time_engine(self, take: Callable[[float], None]) -> None:
        """Call `take` with the processor time s of every step of the engine from now on."""
        make = self._engine

        def timed(*arguments, **options):
            engine = make(*arguments, **options)
            step = engine.step

            def measured(*given) -> None:
                began = time.process_time()
                step(*given)
                take(time.process_time() - began)

            engine.step = measured
            return engine

        self._engine = timed

    def play(self, number: int, scenario: int = 0) -> Result:
        """One episode."""
        began, phases = time.monotonic(), []
        arm = Simulation(
            self._domain,
            seed=self._seed,
            first_episode=number,
            engine=self._engine,
            scenario=scenario,
            patch=self._patch,
            force_reflex=self._force_reflex,
        )
        eyes = KeypointProjector(self._domain, self._patch, self._seed)
        view, driver = CompensatedView(self._corrections, self._domain), CompensatedArm(self._corrections)
        controller, guard = Controller(), SafetyFilter()
        guard.start(driver.read(arm.measure()).position[:7])
        config = EpisodeConfig(self._domain, contacts=self._contacts, success_share=self._domain.tolerance_fraction)
        episode = Episode(config, lambda: driver.read(arm.measure()).position[:7].copy())
        goal = project_keypoints(self._domain, arm.task.goal)
        _note(phases, [*episode.start(), *episode.goal(0, arm.task.goal)])
        while True:
            now = driver.read(arm.measure())
            q, dq = now.position[:7], now.velocity[:7]
            if not guard.watchdog.may_move:
                phases.append(PhaseState(FAULT, guard.watchdog.cause))
                break
            controller.observe(now.stamp, q, dq)
            eyes.look(arm)
            if now.stamp % TICK == 0:
                self._tick(arm, controller, episode, now, view(eyes.seen(now.stamp), now.stamp), goal, phases)
                if not episode.is_active:
                    break
            answer = controller.answer()
            guard.offer(now.stamp, JOINT_NAMES, answer.position, answer.velocity, answer.torque, now=now.stamp)
            arm.step(driver.drive(guard.apply(now.stamp, q, dq).torque, q, dq))
            if arm.reflex:
                guard.fault(arm.reflex)
        outcome = score_outcome(self._domain, phases, arm.object_pose(), arm.task.goal, arm.stamp / SECOND)
        result = result_of(number, outcome, time.monotonic() - began, force=arm.force.figures)
        return replace(result, **self._engine_named)

    def _tick(self, arm: Simulation, controller: Controller, episode: Episode, now, seen, goal, phases) -> None:
        before = episode.phase
        _note(phases, episode.keypoints(now.stamp, seen))
        if episode.phase == PRE and episode.awaits == "joint_trajectory":
            _note(phases, self._approach(arm, controller, episode, now, seen, goal))
        elif episode.phase == PRE and before == POST:
            controller.hold()
        elif episode.phase == POST:
            if before != POST:
                self._post.reset()
            try:
                target = self._post.act(now.position, now.velocity, seen, goal)
                controller.set_target(
                    now.stamp, target.position, target.rotation, target.stiffness, target.damping_ratio
                )
            except (PolicyError, Refusal):
                pass  # as in the graph: the target before stays

    def _approach(self, arm: Simulation, controller: Controller, episode: Episode, now, seen, goal) -> list[Event]:
        try:
            wanted = self._pre.propose(seen, goal)
            object_pose = estimate_pose(seen, self._domain).pose
            plan = plan_approach(
                self._collision, now.position[:7], wanted.pose, wanted.opening, object_pose, seed=self._seed
            )
        except (PlanningError, PoseError, PolicyError) as error:
            return episode.refusal(now.stamp, str(error))
        arm.set_fingers(wanted.opening)
        controller.follow(plan.trajectory, now.stamp)
        return episode.trajectory(now.stamp, plan.trajectory.duration, plan.trajectory.positions[-1])


class KeypointProjector:
    """The object's true corners as a patch's camera shows them, in the detector's place."""

    def __init__(self, domain: Task, patch: Patch, seed: int):
        self._domain = domain
        self._view = CameraEffects(patch, CAMERA, seed) if patch.camera.effects else None
        self._corners = OccludedKeypointBuffer(np.asarray(domain.half_size), self._view.oldest if self._view else 0.0)
        self._pose, self._next = None, 0

    def look(self, arm: Simulation) -> None:
        """Once a control period: keep the object's pose where an image or a tick is due."""
        if arm.stamp % TICK == 0:
            self._pose = arm.object_pose()
        if self._view is not None and (arm.stamp >= self._next or arm.stamp % TICK == 0):
            self._corners.keep(arm.stamp, arm.object_pose())
            self._next = arm.stamp - arm.stamp % IMAGE + IMAGE

    def seen(self, stamp: int) -> np.ndarray:
        """Corners (8, 3) as they are found now, usable where they lie in the image; none of an object that was thrown behind the camera."""
        try:
            seen = project_keypoints(self._domain, self._pose)
        except ValueError:
            return np.zeros((8, 3))
        if self._view is not None:
            seen[:, :2] = self._view.keypoints(self._corners.at, stamp)
        seen[:, 2] = ((seen[:, :2] > -0.5) & (seen[:, :2] < (CAMERA.width - 0.5, CAMERA.height - 0.5))).all(axis=1)
        return seen


def _note(phases: list[PhaseState], events: list[Event]) -> None:
    phases += [event for event in events if isinstance(event, PhaseState)]
