"""A simulated robot and camera behind the topics and services of docs/reference/graph.md, whatever the engine.

Lockstep: a state goes out, and the simulation takes the next step in the callback of the last answer that was
missing; nothing is polled. Real time: a steady 2 ms timer steps with the newest command.
"""

from __future__ import annotations

import gc
import time
from collections.abc import Callable
from functools import partial

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from rclpy.clock import Clock, ClockType
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.node import Node
from rosgraph_msgs.msg import Clock as ClockMessage
from sensor_msgs.msg import CameraInfo, Image, JointState
from std_msgs.msg import Float64
from std_srvs.srv import SetBool, Trigger

from np_control.safety import Applied, Refusal, SafetyFilter, State
from np_description.calibration import calibrated_camera
from np_description.meshes import drawn_model
from np_description.objects import scenarios
from np_description.panda import BASE_FRAME, JOINT_NAMES, STATE_NAMES
from np_description.scene import CAMERA_NAME
from np_effects.patch import Patch, load_patch
from np_effects.view_effects import ViewEffects
from np_ros import qos
from np_ros.arrivals import Arrivals
from np_ros.domain import OnlyPublisher
from np_ros.messages import (
    BadMessage,
    camera_info_message,
    image_message,
    joint_state_message,
    pose_message,
    stamp_message,
    stamp_nanoseconds,
)
from np_ros.node import Diagnostics, parameter
from np_ros.phases import phase_state
from np_ros.spin import request_realtime
from np_ros.task_domain import declare_domain
from np_sim_bridge.barrier import ACTIVE_PHASES, Barrier
from np_sim_bridge.engine import MakeEngine
from np_sim_bridge.imaging import CameraThread
from np_sim_bridge.renderer import RENDERERS, make_renderer
from np_sim_bridge.renderer_process import RendererProcess
from np_sim_bridge.schedule import PERIOD, SECOND, Schedule
from np_sim_bridge.simulation import Simulation
from np_sim_bridge.view import View

REPEAT_AFTER = 1.0  # s of wall time without an answer, after which a state is published again
ARRIVED_WITHIN = 2 * SECOND  # ns that time goes on without a moment at which all that was published had arrived
LISTENERS = "arrival at who listens"
APPLIED_EVERY = 5 * PERIOD  # ns between messages on applied_command: 100 Hz
WARN, ERROR = DiagnosticStatus.WARN, DiagnosticStatus.ERROR
SHAPES, MESHES = LOOKS = "shapes", "meshes"
LEVELS = {State.HOLDING: WARN, State.STOPPED: ERROR, State.FAULT: ERROR}


class Bridge(Node):
    """Owns the simulation and its time; every message in or out is translated here.

    name: of the node, before its services; engine: builds the physics. Raises what that raises.
    """

    def __init__(self, name: str, engine: MakeEngine):
        super().__init__(name)
        domain = declare_domain(self)
        seed = parameter(self, "seed", 0, "With the episode's number it names the task.", 0, 2**31 - 1)
        first = parameter(self, "first_episode", 0, "Number of the episode that the first reset draws.", 0, 2**31 - 1)
        scenario = parameter(
            self, "scenario", 0, "Fixed task of every episode; 0: tasks are drawn.", 0, scenarios.COUNT
        )
        substeps = parameter(self, "substeps", 1, "Physics steps in a control period of 2 ms.", 1, 20)
        mode = parameter(
            self, "mode", "lockstep", "Who waits: time for the answers, or nobody.", choices=("lockstep", "realtime")
        )
        policy_rate = parameter(self, "policy_rate", 10, "Policy ticks a second; a divisor of 500.", 1, 500)
        image_rate = parameter(self, "image_rate", 30, "Images a second; policy ticks have one in any case.", 1, 500)
        camera = parameter(self, "camera", True, "Whether images are drawn.")
        calibration = parameter(
            self, "calibration", "", "File written by `calibrate`: where the camera is; empty: as trained."
        )
        renderer = parameter(
            self,
            "renderer",
            "auto",
            "What draws them: OpenGL (egl), a ray caster on the CPU (warp), or whichever works (auto).",
            choices=RENDERERS,
        )
        shadows = parameter(self, "shadows", True, "Whether the arm casts a shadow in the images.")
        look = parameter(
            self,
            "arm_look",
            SHAPES,
            "The arm in the images: the shapes that collide, with which detectors are trained, or meshes (`make meshes`).",
            choices=LOOKS,
        )
        self._tick_barrier = parameter(
            self, "tick_barrier", True, "Lockstep: whether time waits for ticks and targets too."
        )
        self._timeout = parameter(
            self,
            "lockstep_timeout",
            120.0,
            "Lockstep: s of wall time that an answer may be missing before the arm is stopped.",
            1.0,
            3600.0,
        )
        priority = parameter(self, "realtime_priority", 0, "SCHED_FIFO priority; 0 asks for none.", 0, 90)
        effects = parameter(self, "effects", "", "Patch file of effects that the nominal arm and its camera lack.")
        self._lockstep = mode == "lockstep"
        self._schedule = Schedule(policy_rate, image_rate)
        self._barrier = Barrier(self._schedule, tick_barrier=self._tick_barrier)
        patch = load_patch(effects) if effects else Patch()
        view = ViewEffects(patch, calibrated_camera(calibration), seed)
        self._believed, self._view = view.believed, View(view)
        self._simulation = Simulation(
            domain,
            scenario=scenario,
            seed=seed,
            first_episode=first,
            substeps=substeps,
            camera=view.camera,
            patch=patch,
            engine=engine,
        )
        self._filter = SafetyFilter()
        self._next_episode = first
        self._paused = False
        self._armed = False  # whether a missing answer is an error, or nobody has started yet
        self._waiting_since = self._repeated_at = time.monotonic()
        self._due: int | None = None  # monotonic ns of the period to come
        self._reported: tuple[State, str] | None = None
        self._state_messages: list[tuple] = []
        self._last_image: tuple[int, list[tuple]] = (-1, [])  # stamp, messages; set by the camera's thread
        self._create_publishers()
        # Before the camera's thread: a process that ends with OpenGL at work in it crashes.
        self._right = OnlyPublisher(self, "joint_states")
        self._camera = None
        if camera:
            drawn = self._simulation.model
            if look == MESHES:  # a second model: what is simulated knows nothing of meshes
                change = patch.scene_change()
                drawn = drawn_model(domain, meshes=True, camera=view.camera, panda=patch.panda(), change=change)
            make = partial(make_renderer if self._lockstep else RendererProcess, renderer, drawn, shadows=shadows)
            self._camera = CameraThread(make, self._publish_image)
        self.diagnostics = Diagnostics(self)
        self.diagnostics.values.update(mode=mode, domain=domain.name, seed=seed, effects=effects or "none")
        if ignored := self._simulation.ignored_effects:
            self.get_logger().warn(f"effects that a backend cannot carry: {', '.join(ignored)}")
        if camera and (left_out := view.only_in_keypoints):
            self.get_logger().warn(f"effects that images do not carry, but keypoint_oracle does: {', '.join(left_out)}")
        if priority and not request_realtime(priority):  # for this thread: the camera's has been started
            self.get_logger().warn(f"SCHED_FIFO priority {priority} is not permitted; running without it")
        self._create_inputs()
        self._stand_at_task()
        gc.collect()
        gc.freeze()  # what start-up made stays: later collections need not walk it

    def _create_publishers(self) -> None:
        stream = qos.publisher(self._lockstep)
        # Whoever joins while time stands still must get the state that it stands at.
        joined = PublisherEventCallbacks(matched=lambda _: self._repeat()) if self._lockstep else None
        self._joint_states = self.create_publisher(JointState, "joint_states", stream, event_callbacks=joined)
        self._applied = self.create_publisher(JointState, "applied_command", stream)
        self._object_pose = self.create_publisher(PoseStamped, "object_pose", stream)
        self._clock_topic = self.create_publisher(ClockMessage, "clock", stream)
        self._image = self.create_publisher(Image, "camera/image_raw", stream, event_callbacks=joined)
        self._camera_info = self.create_publisher(CameraInfo, "camera/camera_info", stream)
        self._goal_pose = self.create_publisher(PoseStamped, "goal_pose", qos.LATCHED)
        streams = (
            self._joint_states,
            self._applied,
            self._object_pose,
            self._clock_topic,
            self._image,
            self._camera_info,
        )
        self._arrivals = Arrivals(streams, ARRIVED_WITHIN)

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
            # Time does not stand still while the arm is being stopped: nobody's answer is needed for that.
            self._coast = self.create_timer(0.001, self._on_coast, clock=steady)
            self._coast.cancel()
        else:
            self.create_timer(PERIOD / SECOND, self._on_period, clock=steady)

    # Commands

    def _on_command(self, message: JointState) -> None:
        if (stamp := self._read(stamp_nanoseconds, message.header.stamp)) is None:
            return
        if self._lockstep and stamp < self._simulation.stamp and stamp == self._answered:
            return  # the second answer to a state that was published twice
        try:
            self._filter.offer(
                stamp, message.name, message.position, message.velocity, message.effort, now=self._simulation.stamp
            )
        except Refusal as refusal:
            self.diagnostics.refuse(refusal.reason, refusal)
        else:
            self._armed |= not self._tick_barrier
        if self._lockstep and stamp == self._simulation.stamp:
            # A refused answer is an answer too: the period counts as missed, and the watchdog decides.
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
            self._waiting_since = time.monotonic()

    def _read(self, read: Callable, part: object):
        """What `read` makes of a part of a message; None where it refuses it, which is counted."""
        try:
            return read(part)
        except BadMessage as error:
            self.diagnostics.refuse(error.kind, error)
            return None

    # Time

    def _advance(self) -> None:
        """Lockstep: take the next step if every answer is there, and everybody has what was said until not long ago."""
        if not self._paused and self._filter.watchdog.may_move and self._barrier.missing() is None:
            if self._arrivals.are_recent(self._simulation.stamp):
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
        self._publish_state()
        if measured.stamp % APPLIED_EVERY == 0:
            self._publish_applied(measured.stamp, applied)
        self._report()

    def _look_for_silence(self) -> None:
        """Lockstep: publish a state again that nobody answers, and stop the arm if that does not help."""
        topic = self._barrier.missing()
        if topic is None and not self._look_for_arrival.is_canceled():
            topic = LISTENERS
        now = time.monotonic()
        self.diagnostics.values["waiting_for"] = topic or ""
        if topic is None or self._paused or not self._filter.watchdog.may_move:
            return
        if now - self._repeated_at > REPEAT_AFTER and topic != LISTENERS:
            self._repeat()
        if self._armed and now - self._waiting_since > self._timeout:
            self._armed = False
            cause = f"lockstep: no {topic} for the state of {self._simulation.stamp} ns within {self._timeout:g} s"
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
        stamp = self._schedule.next_policy_tick(self._simulation.stamp)
        self._simulation.reset(self._next_episode, stamp)
        self._view.begin()
        self._next_episode += 1
        self._stand_at_task()
        return f"episode {self._simulation.task.episode} at {stamp} ns"

    def _stand_at_task(self) -> None:
        """Hold the ready posture, and say which goal and state the episode begins with."""
        task, goal = self._simulation.task, self._simulation.task.goal
        self.diagnostics.values["episode"] = task.episode
        self._answered = -1
        self._filter.start(self._simulation.measure().position[:7])
        self._goal_pose.publish(pose_message(self._simulation.stamp, BASE_FRAME, goal.position, goal.quaternion))
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
        stamp = measured.stamp
        self._barrier.begin(stamp)
        joints = joint_state_message(stamp, STATE_NAMES, measured.position, measured.velocity, measured.effort)
        self._joint_states.publish(joints)  # first, so that the controller thinks while the rest is sent
        clock = ClockMessage(clock=stamp_message(stamp))
        self._clock_topic.publish(clock)
        self._state_messages = [(self._joint_states, joints), (self._clock_topic, clock)]
        if self._camera is not None:
            self._view.keep(stamp, simulation.configuration)
        if self._schedule.is_image_due(stamp):
            pose = simulation.object_pose()
            truth = pose_message(stamp, BASE_FRAME, pose.position, pose.quaternion)
            self._object_pose.publish(truth)
            self._state_messages.append((self._object_pose, truth))
            if self._camera is not None:
                scene = self._view.scene(stamp, simulation.configuration)
                if not self._camera.submit(stamp, scene, wait=self._lockstep):
                    self.diagnostics.count("dropped_images")
        self._waiting_since = self._repeated_at = time.monotonic()
        self.diagnostics.values["stamp"] = stamp

    def _publish_image(self, stamp: int, pixels: np.ndarray) -> None:
        """Called in the camera's thread."""
        messages = [
            (self._camera_info, camera_info_message(stamp, CAMERA_NAME, self._believed)),
            (self._image, image_message(stamp, CAMERA_NAME, self._view.through_lens(pixels))),
        ]
        for publisher, message in messages:
            publisher.publish(message)
        self._last_image = stamp, messages

    def _repeat(self) -> None:
        """Publish the present state again, for those who have not heard it."""
        self._repeated_at = time.monotonic()
        stamp, images = self._last_image
        images = images if stamp == self._simulation.stamp else []
        for publisher, message in [*self._state_messages, *images]:
            publisher.publish(message)

    def _publish_applied(self, stamp: int, applied: Applied) -> None:
        self._applied.publish(
            joint_state_message(stamp, JOINT_NAMES, applied.position, applied.velocity, applied.torque)
        )

    def _report(self) -> None:
        """Tell the state, and what it means: published at once when it changes."""
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
