"""A simulated robot and camera behind the topics and services of docs/reference/graph.md, whatever the engine.

Lockstep: a state is published, and the simulation takes the next step in the callback of the last missing
reply; nothing is polled. Real time: a steady 2 ms timer steps with the newest command.
"""

from __future__ import annotations

import gc
import time
from collections.abc import Callable
from functools import partial

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from sensor_msgs.msg import JointState
from sim2real.effects.camera_effects import CameraEffects
from sim2real.effects.patch import Patch, load_patch
from std_msgs.msg import Float64
from std_srvs.srv import SetBool, Trigger

from np_control.controller import ControllerConfig
from np_control.safety import Refusal, SafetyFilter, State
from np_control.safety.refusals import check_finite
from np_description.calibration import load_calibrated_camera
from np_description.drawing.meshes import load_visual_model
from np_description.engine import MakeEngine
from np_description.message_arrays import BadMessage, stamp_nanoseconds
from np_ros import qos
from np_ros.low_latency.spin import request_realtime
from np_ros.node import Diagnostics
from np_ros.phases import phase_state
from np_ros.processes.domain import OnlyPublisher
from np_sim_bridge.barrier import ACTIVE_PHASES, LockstepBarrier
from np_sim_bridge.nodes.publishers import BridgePublishers
from np_sim_bridge.nodes.settings import MESHES, declare
from np_sim_bridge.renderer import make_renderer
from np_sim_bridge.renderer_process import RendererProcess
from np_sim_bridge.schedule import PERIOD, SECOND, Schedule
from np_sim_bridge.simulated_camera import SimulatedCamera
from np_sim_bridge.simulation import Simulation

REPEAT_AFTER = 1.0  # s of wall time without a reply, after which a state is published again
LISTENERS = "arrival at who listens"
APPLIED_EVERY = 5 * PERIOD  # ns between messages on applied_command: 100 Hz
WARN, ERROR = DiagnosticStatus.WARN, DiagnosticStatus.ERROR
LEVELS = {State.HOLDING: WARN, State.STOPPED: ERROR, State.FAULT: ERROR}


class Bridge(Node):
    """Owns the simulation and its time; every message in or out is translated here.

    name: of the node, before its services; engine: builds the physics. Raises what that raises.
    """

    def __init__(self, name: str, engine: MakeEngine):
        super().__init__(name)
        self._settings = settings = declare(self)
        self._lockstep = settings.lockstep
        self._schedule = Schedule(settings.policy_rate, settings.image_rate)
        self._barrier = LockstepBarrier(self._schedule, tick_barrier=settings.tick_barrier)
        patch = load_patch(settings.effects) if settings.effects else Patch()
        view = CameraEffects(patch, load_calibrated_camera(settings.calibration), settings.seed)
        self._simulation = Simulation(
            settings.domain,
            scenario=settings.scenario,
            seed=settings.seed,
            first_episode=settings.first_episode,
            substeps=settings.substeps,
            camera=view.camera,
            patch=patch,
            engine=engine,
            force_reflex=settings.force_reflex,
        )
        self._filter = SafetyFilter()
        self._next_episode = settings.first_episode
        self._paused = False
        self._armed = False  # whether a missing reply is an error, or no controller has started yet
        self._waiting_since = self._repeated_at = time.monotonic()
        self._due: int | None = None  # monotonic ns of the period to come
        self._reported: tuple[State, str] | None = None
        self._outlet = BridgePublishers(self, view.believed, lockstep=settings.lockstep, joined=self._repeat)
        # Before the camera's thread: a process that ends with OpenGL at work in it crashes.
        self._right = OnlyPublisher(self, "joint_states")
        self._camera = self._make_camera(patch, view) if settings.camera else None
        self.diagnostics = Diagnostics(self)
        self.diagnostics.values.update(
            mode=settings.mode, domain=settings.domain.name, seed=settings.seed, effects=settings.effects or "none"
        )
        self.diagnostics.values["force_reflex"] = settings.force_reflex
        self.diagnostics.values["external_force"] = self._simulation.force
        if ignored := self._simulation.ignored_effects:
            self.get_logger().warn(f"effects that a backend cannot carry: {', '.join(ignored)}")
        if settings.camera and (left_out := view.only_in_keypoints):
            self.get_logger().warn(f"effects that images do not carry, but keypoint_oracle does: {', '.join(left_out)}")
        if (priority := settings.priority) and not request_realtime(priority):  # the camera's thread has been started
            self.get_logger().warn(f"SCHED_FIFO priority {priority} is not permitted; running without it")
        self._create_inputs()
        self._stand_at_task()
        gc.collect()
        gc.freeze()  # what start-up made stays: later collections need not walk it

    def _make_camera(self, patch: Patch, view: CameraEffects) -> SimulatedCamera:
        settings, drawn = self._settings, self._simulation.model
        if settings.look == MESHES:  # a second model: the simulated one has no meshes
            change = patch.scene_change()
            drawn = load_visual_model(
                settings.domain, meshes=True, camera=view.camera, panda=patch.panda(), change=change
            )
        kind = make_renderer if self._lockstep else RendererProcess
        make = partial(kind, settings.renderer, drawn, shadows=settings.shadows)
        return SimulatedCamera(make, view, self._outlet.image, wait=self._lockstep)

    def _create_inputs(self) -> None:
        stream = qos.subscriber(self._lockstep)
        self.create_subscription(Float64, "gripper_command", self._on_gripper, qos.EVENT)
        if self._lockstep:
            self.create_subscription(DiagnosticArray, "episode/phase", self._on_phase, qos.LATCHED)
            self.create_subscription(DiagnosticArray, "episode/tick", self._on_tick, stream)
            self.create_subscription(PoseStamped, "target_pose", self._on_target, stream)
        self.create_subscription(JointState, "effort_command", self._on_command, stream)
        self.create_service(Trigger, "~/reset", self._service(self._reset))
        self.create_service(Trigger, "~/step", self._service(self._step_once))
        self.create_service(Trigger, "~/stop", self._service(self._stop))
        self.create_service(Trigger, "~/recover", self._service(self._recover))
        self.create_service(SetBool, "~/pause", self._on_pause)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        if self._lockstep:
            self.create_timer(0.25, self._look_for_silence, clock=steady)
            self._look_for_arrival = self.create_timer(0.001, self._on_arrival, clock=steady)
            self._look_for_arrival.cancel()
            # Time does not stand still while the arm is being stopped: that needs no reply.
            self._coast = self.create_timer(0.001, self._on_coast, clock=steady)
            self._coast.cancel()
        else:
            self.diagnostics.counts["missed_periods"] = 0  # a recording without a miss shows that they were counted
            self.create_timer(PERIOD / SECOND, self._on_period, clock=steady)

    # Commands

    def _on_command(self, message: JointState) -> None:
        if (stamp := self._read(stamp_nanoseconds, message.header.stamp)) is None:
            return
        # The second command for a state that was published twice is not applied; a broken one is counted all the same.
        is_second = self._lockstep and stamp < self._simulation.stamp and stamp == self._answered
        try:
            if is_second:
                check_finite(position=message.position, velocity=message.velocity, effort=message.effort)
                return
            self._filter.offer(
                stamp, message.name, message.position, message.velocity, message.effort, now=self._simulation.stamp
            )
        except Refusal as refusal:
            self.diagnostics.refuse(refusal.reason, refusal)
        else:
            self._armed |= not self._settings.tick_barrier
        if self._lockstep and stamp == self._simulation.stamp:
            # A refused command ends the wait too: the period counts as missed, and the watchdog decides.
            self._answered = stamp
            self._barrier.command(stamp)
            self._advance()

    def _on_gripper(self, message: Float64) -> None:
        try:
            self._simulation.set_fingers(message.data)
        except ValueError as error:
            self.diagnostics.refuse("gripper", error)

    def _on_tick(self, message: DiagnosticArray) -> None:
        stamp, state = self._read(stamp_nanoseconds, message.header.stamp), self._read(phase_state, message)
        if stamp is not None and state is not None:
            self._barrier.tick(stamp, state.phase)
            self._advance()

    def _on_target(self, message: PoseStamped) -> None:
        if (stamp := self._read(stamp_nanoseconds, message.header.stamp)) is not None:
            self._barrier.target(stamp)
            self._advance()

    def _on_phase(self, message: DiagnosticArray) -> None:
        if (state := self._read(phase_state, message)) is not None:
            self._armed = state.phase in ACTIVE_PHASES
            if not self._armed:
                self.diagnostics.publish()  # what the episode came to
            self._waiting_since = time.monotonic()

    def _read(self, read: Callable, part: object):
        """The result of `read` on a part of a message; None where it refuses it, which is counted."""
        try:
            return read(part)
        except BadMessage as error:
            self.diagnostics.refuse(error.kind, error)
            return None

    # Time

    def _advance(self) -> None:
        """Lockstep: take the next step if every reply is there, and every subscriber has what was published until not long ago."""
        if not self._paused and self._filter.watchdog.may_move and self._barrier.missing() is None:
            if self._outlet.has_arrived(self._simulation.stamp):
                self._step()
            else:  # a recorder that gets no processor: nothing is lost, for time waits
                self._look_for_arrival.reset()

    def _on_arrival(self) -> None:
        self._look_for_arrival.cancel()
        self._advance()

    def _on_coast(self) -> None:
        if self._filter.watchdog.may_move or self._filter.at_rest or self._paused:
            self._coast.cancel()
        else:
            self._step()

    def _on_period(self) -> None:
        now = time.monotonic_ns()
        late = 0 if self._due is None else max(0, (now - self._due) // PERIOD)
        for _ in range(late):
            self.diagnostics.count("missed_periods")
        self._due = (now if self._due is None else self._due + late * PERIOD) + PERIOD
        if not self._paused:
            self._step()

    def _step(self) -> None:
        """One control period: guard and apply the newest command, and publish the state it leads to."""
        measured = self._measured
        applied = self._filter.apply(measured.stamp, measured.position[:7], measured.velocity[:7])
        self._simulation.step(applied.torque)
        if self._simulation.reflex:
            self._filter.fault(self._simulation.reflex)
        self._publish_state()
        if measured.stamp % APPLIED_EVERY == 0:
            self._outlet.applied(measured.stamp, applied)
        self._report()

    def _look_for_silence(self) -> None:
        """Lockstep: publish a state again that gets no reply, and stop the arm if that does not help."""
        topic = self._barrier.missing()
        if topic is None and not self._look_for_arrival.is_canceled():
            topic = LISTENERS
        now = time.monotonic()
        self.diagnostics.values["waiting_for"] = topic or ""
        if topic is None or self._paused or not self._filter.watchdog.may_move:
            return
        if now - self._repeated_at > REPEAT_AFTER and topic != LISTENERS:
            self._repeat()
        if self._armed and now - self._waiting_since > self._settings.timeout:
            self._armed = False
            cause = (
                f"lockstep: no {topic} for the state of {self._simulation.stamp} ns within {self._settings.timeout:g} s"
            )
            self.get_logger().error(cause)
            self._stop(cause)

    # Services

    @staticmethod
    def _service(action: Callable[[], str]) -> Callable:
        def handle(_request, response):
            try:
                response.message, response.success = action(), True
            except ValueError as error:  # a Refusal is one
                response.message, response.success = str(error), False
            return response

        return handle

    def _reset(self) -> str:
        if not self._filter.watchdog.may_move:
            raise ValueError(f"cannot reset: {self._filter.state} ({self._filter.watchdog.cause}); recover first")
        # A gap by which every controller begins anew, wherever the arm was.
        gap = PERIOD if self._lockstep else ControllerConfig.largest_gap_ns
        stamp = self._schedule.next_policy_tick(self._simulation.stamp + gap)
        self._simulation.reset(self._next_episode, stamp)
        if self._camera is not None:
            self._camera.begin()
        self._next_episode += 1
        self._stand_at_task()
        return f"episode {self._simulation.task.episode} at {stamp} ns"

    def _stand_at_task(self) -> None:
        """Hold the ready posture, and publish the goal and state that the episode begins with."""
        task = self._simulation.task
        self.diagnostics.values["episode"] = task.episode
        self._answered = -1
        self._filter.start(self._simulation.measure().position[:7])
        self._outlet.goal(self._simulation.stamp, task.goal)
        self._publish_state()
        self._report()

    def _on_pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        self._paused = request.data
        response.success, response.message = True, "paused" if self._paused else "running"
        if self._lockstep and not self._paused:
            self._waiting_since = time.monotonic()
            self._coast.reset()
            self._advance()
        return response

    def _step_once(self) -> str:
        if not (self._lockstep or self._paused):
            raise ValueError("step: in real time only while paused")
        self._step()
        return f"{self._simulation.stamp} ns"

    def _stop(self, cause: str = "stop requested") -> str:
        self._filter.stop(cause)
        self._report()
        return cause

    def _recover(self) -> str:
        self._measured = self._simulation.measure()  # anew: what was published last may be what the fault is about
        self._filter.recover(self._measured.position[:7])
        self._report()
        if self._lockstep:
            self._barrier.begin(self._simulation.stamp)
            self._repeat()
        return "holding the measured posture"

    # Messages out

    def _publish_state(self) -> None:
        simulation = self._simulation
        self._measured = measured = simulation.measure()
        stamp, is_due = measured.stamp, self._schedule.is_image_due(measured.stamp)
        self._barrier.begin(stamp)
        self._outlet.state(measured, simulation.wrench)
        if is_due:
            self._outlet.object_pose(stamp, simulation.object_pose())
        if self._camera is not None and not self._camera.see(stamp, simulation.configuration, is_due=is_due):
            self.diagnostics.count("dropped_images")
        self._waiting_since = self._repeated_at = time.monotonic()
        self.diagnostics.values["stamp"] = stamp

    def _repeat(self) -> None:
        """Publish the present state again, for subscribers that have not received it."""
        self._repeated_at = time.monotonic()
        self._outlet.repeat(self._simulation.stamp)

    def _report(self) -> None:
        """Report the state, and what it means: published at once when it changes."""
        state, cause = self._filter.state, self._filter.watchdog.cause
        if self._lockstep and not self._filter.watchdog.may_move:
            self._coast.reset()
        if (state, cause) != self._reported:
            self._reported = state, cause
            self.diagnostics.values["state"] = str(state)
            level = LEVELS.get(state, WARN if self._simulation.held_back else DiagnosticStatus.OK)
            self.diagnostics.report(level, "; ".join((f"{state}: {cause}", *self._simulation.held_back)))

    def destroy_node(self) -> None:
        """Finish the images under way."""
        if self._camera is not None:
            self._camera.close()
        super().destroy_node()
        self._right.release()
