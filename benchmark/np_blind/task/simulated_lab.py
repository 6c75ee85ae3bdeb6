"""The task suite in a simulated reality without a graph: the bridge's simulation, guards and controller in one process, a period at a time."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from sim2real.effects.camera_effects import CameraEffects
from sim2real.effects.patch import Patch
from sim2real.excitation.contact_suite.monitor import OutOfPicture, SuiteMonitor
from sim2real.excitation.contact_suite.suite import SuiteState, task_suite
from sim2real.excitation.contact_suite.tip_path import rest_segment
from sim2real.excitation.suite import Segment, end_stamp, schedule_starts
from sim2real.recordings.reading import SECOND
from sim2real.recordings.signals import Commands, Log
from sim2real.task.keypoint_track import KeypointTrack
from sim2real.task.suite.recording import TaskRecording, spans_of
from sim2real.thresholds import THRESHOLDS

from np_control.controller import Controller, ControllerOutput
from np_control.impedance import damping
from np_control.safety import LIMITS, SafetyFilter
from np_description.camera import CAMERA
from np_description.domains import Pose, Task
from np_description.engine import MakeEngine
from np_description.panda import JOINT_NAMES
from np_description.phases import EXCITE, PhaseState
from np_perception.occluded_keypoints import OccludedKeypointBuffer
from np_sim_bridge.schedule import PERIOD, Schedule
from np_sim_bridge.simulation import Simulation

TORQUE_NOISE = 0.03  # Nm, white, of a joint's torque sensor
WITNESSED = 10 * PERIOD  # ns between states that the suite's guard looks at
FIRST = 0.5  # s, in which the first images come
PIXEL_NOISE = 0.3  # px, of a corner in an image
Images = list[tuple[int, np.ndarray]]
"""Stamps ns and keypoints (8, 3) u px, v px, score."""


class CameraModel(Protocol):
    """A camera and its detector."""

    def look(self, stamp: int, pose: Pose, q: np.ndarray, is_due: bool) -> Images:
        """See `PlainEye.look`."""


class PlainCamera:
    """The product's own simulated camera, with white noise."""

    def __init__(self, half: np.ndarray, patch: Patch, seed: int):
        self._view, self._rng = CameraEffects(patch, CAMERA, seed), np.random.default_rng([seed, 6])
        self._corners = OccludedKeypointBuffer(half, self._view.oldest)

    def look(self, stamp: int, pose: Pose, q: np.ndarray, is_due: bool) -> Images:
        """Of the state at `stamp` ns, later than any before: the object's pose, joints (7,) rad, and whether an image is to have that stamp.
        What is ready by now."""
        if not is_due:
            return []
        self._corners.keep(stamp, pose)
        seen = self._view.keypoints(self._corners.at, stamp)
        seen = seen + PIXEL_NOISE * self._rng.standard_normal(seen.shape)
        inside = ((seen > -0.5) & (seen < np.array([CAMERA.width, CAMERA.height]) - 0.5)).all(axis=1)
        return [(stamp, np.column_stack([seen, inside.astype(float)]))]


@dataclass
class _Kept:
    stamps: list[int] = field(default_factory=list)
    joints: list[np.ndarray] = field(default_factory=list)
    images: list[tuple[int, np.ndarray]] = field(default_factory=list)
    phases: list[tuple[int, str]] = field(default_factory=list)
    answers: list[ControllerOutput] = field(default_factory=list)
    gains: list[np.ndarray] = field(default_factory=list)


class SimulatedLab:
    """A simulated robot with a task, which can be led through plans and stores what it measured.

    domain: the nominal one; patch: the deviations from it; seed: of task and noise; engine: builds the physics; eye: the
    camera (default: `PlainCamera`); true: the domain as it is, where its object is not of the nominal size.
    """

    def __init__(
        self,
        domain: Task,
        patch: Patch,
        seed: int,
        engine: MakeEngine,
        eye: CameraModel | None = None,
        true: Task | None = None,
    ):
        self.domain, self._rng = domain, np.random.default_rng([seed, 1])
        self._simulation = Simulation(true or domain, seed=seed, patch=patch, engine=engine)
        self._controller, self._filter, self._schedule = Controller(), SafetyFilter(), Schedule(10, 30)
        self._eye = eye or PlainCamera(np.asarray((true or domain).half_size), patch, seed)
        self._kept = _Kept()
        self._filter.start(self._simulation.measure().position[:7])
        self._witness = SuiteMonitor(domain)
        self._note()

    def run(self, only: tuple[str, ...] = (), is_cut: bool = False) -> TaskRecording:
        """The suite, or some of its families, and what was recorded of it: up to where the object has left the picture. is_cut: up to where the
        suite's guard ends it, too, which raises RuntimeError else."""
        if not self._witness.has_image(0):  # an image is ready once its last row is read
            self._lead([rest_segment("transfer", self._simulation.measure().position[:7], FIRST)])
        plans = task_suite(self.domain, self._situation(), only)
        plan = next(plans)
        while plan is not None:
            try:
                self._lead(plan)
            except RuntimeError:
                if not is_cut:
                    raise
                break
            try:
                plan = plans.send(self._situation())
            except (StopIteration, OutOfPicture):
                plan = None
        return self._recording()

    def _situation(self) -> SuiteState:
        return self._witness.state(self._simulation.measure().position[:7])

    def _lead(self, plan: list[Segment]) -> None:
        begin = self._simulation.stamp
        starts, end, sent = schedule_starts(plan, begin), end_stamp(plan, begin), 0
        while self._simulation.stamp < end:
            measured = self._simulation.measure()
            self._controller.observe(measured.stamp, measured.position[:7], measured.velocity[:7])
            if sent < len(plan) and measured.stamp >= starts[sent]:
                self._kept.phases.append((measured.stamp, plan[sent].name))
                self._controller.follow(plan[sent].trajectory, measured.stamp, plan[sent].gains)
                sent += 1
            answer = self._controller.answer()
            self._kept.answers.append(answer)
            self._kept.gains.append(plan[max(sent - 1, 0)].gains)
            stamp = measured.stamp
            self._filter.offer(stamp, JOINT_NAMES, answer.position, answer.velocity, answer.torque, now=stamp)
            self._simulation.step(self._filter.apply(stamp, measured.position[:7], measured.velocity[:7]).torque)
            self._note()

    def _note(self) -> None:
        measured, stamp = self._simulation.measure(), self._simulation.stamp
        noise = TORQUE_NOISE * self._rng.standard_normal(7)
        self._kept.stamps.append(stamp)
        self._kept.joints.append(np.stack([measured.position[:7], measured.velocity[:7], measured.effort[:7] + noise]))
        if stamp % WITNESSED == 0 and (problem := self._witness.check_contact(*self._kept.joints[-1])):
            raise RuntimeError(problem)
        is_due = self._schedule.is_image_due(stamp)
        for image in self._eye.look(stamp, self._simulation.object_pose(), measured.position[:7], is_due):
            self._kept.images.append(image)
            self._witness.add_keypoints(*image)

    def _recording(self) -> TaskRecording:
        time = np.array(self._kept.stamps) / SECOND
        position, velocity, effort = np.array(self._kept.joints).transpose(1, 0, 2)
        phases = tuple((at / SECOND, PhaseState(EXCITE, experiment=name)) for at, name in self._kept.phases)
        log = Log(
            "task", time, position, velocity, effort, time - LIMITS.period / 2, False, self._commands(), phases=phases
        )
        stamps, found = zip(*self._kept.images)
        seen, found = np.array(stamps) / SECOND, np.array(found)
        track = KeypointTrack("task", seen - seen[0], found[..., :2], found[..., 2] >= THRESHOLDS.keypoint_track.score)
        return TaskRecording(log, track, float(seen[0]), self.domain, spans_of(log))

    def _commands(self) -> Commands:
        """Commands for all states but the last, as a recording of the graph has them."""
        answers, (stiffness, ratio) = self._kept.answers, np.array(self._kept.gains).transpose(1, 0, 2)
        target, velocity, torque = (
            np.array([getattr(one, name) for one in answers]) for name in ("position", "velocity", "torque")
        )
        at = np.array([one.stamp for one in answers]) / SECOND
        rows = np.searchsorted(np.array(self._kept.stamps) / SECOND, at)
        return Commands(rows, target, velocity, torque, at + LIMITS.period / 2, stiffness, damping(stiffness, ratio))
