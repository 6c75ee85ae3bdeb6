"""A simulated FR3 that speaks libfranka's protocol on a loopback address, with faults on request.

Run by simulated_robot.py in the simulator's own environment, which has nothing of this project. It is
franky-sim's server; added are what it does not simulate itself, and a record of what the arm really did.
Standard input takes one request a line and standard output gives one JSON object for each, `state` and
whatever else was asked:

    drop N           keep the next N states to itself, and hear nothing meanwhile
    mute, unmute     let nothing pass in either direction
    strict, lenient  from now on give up after 20 cycles without a command, as the robot does, or wait
    forget           begin anew to look for the longest pause between two cycles
    reflex           abort the motion as a collision does, until automatic error recovery
    trace PATH       write the last 100 s: rows of time s, q, dq, torque told (7 each), greatest change of
                     torque between two commands, whether the client commands

The first line out is {"hostname": ...}. The process keeps its memory, where that is permitted: a page that
has to come back from a busy disk is a robot that says nothing for up to a second, which is what libfranka
takes for a lost connection.
"""

from __future__ import annotations

import ctypes
import json
import os
import struct
import sys
import time
from collections import deque
from collections.abc import Iterator

import numpy as np
from franky_sim import SimulationServer, mujoco_simulator
from franky_sim.base_simulator import RobotParameters
from franky_sim.franka_robot_protocol import (
    AutomaticErrorRecoveryCommand, MoveStatus, RobotCommand, RobotMode)
from franky_sim.franka_robot_server import ControlMode, FrankaRobotServer
from franky_sim.franka_server import BaseCommand, ConnectCommand, ConnectStatus, FrankaServer, MessageHeader
from simulated_fr3 import SimulatedFr3

READY = (0.0, -0.785398, 0.0, -2.356194, 0.0, 1.570796, 0.785398)
# The robot's own hold while nobody controls it. franky-sim's gains chatter for ever after a stop from speed.
HOLD_STIFFNESS = (600.0, 600.0, 600.0, 600.0, 250.0, 150.0, 50.0)  # Nm/rad
HOLD_DAMPING = (50.0, 50.0, 50.0, 50.0, 30.0, 25.0, 15.0)  # Nms/rad
# joint_reflex and communication_constraints_violation among libfranka's 41 errors
JOINT_REFLEX, COMMUNICATION = 6, 25
PATIENCE = 20  # cycles without a command: FCI documentation, "Network bandwidth, delay and jitter test"
TRACED = 100_000  # cycles
SERVED_EVERY = 4  # cycles from one look at requests, and at the hand, to the next
COUNTED = 100  # cycles of which the robot tells the share that brought a command
TORQUE_OFFSET = 8 + 38 * 8 + 2  # bytes, of tau_J_d in a command: UDPCommand.STRUCT of franky-sim
LOCK_ALL = 1 | 2  # MCL_CURRENT and MCL_FUTURE of mlockall(2)


class Robot(FrankaRobotServer):
    """franky-sim's robot, which can also lose states and abort motions."""

    library_version = property(lambda self: self.protocol)
    error: int | None = None  # what it aborted the motion for
    drop = 0  # states that are still to be lost
    is_mute = is_strict = False
    missed = 0  # cycles without a command, in a row
    cycles = 0
    commanded = unanswered = 0  # cycles in which the client commands, and those of them without a command
    step = 0.0  # Nm, the greatest change from one command to the next, in this cycle
    pause = 0.0  # s of the machine's time, the longest from one cycle to the next
    trace = np.zeros((TRACED, 24))

    def process_commands(self):
        self.heard = False
        if self.is_mute:
            self._post_process_commands()
        elif self.is_served:
            super().process_commands()
        else:
            self._pre_process_commands()
            self._process_udp_commands()
            self._post_process_commands()
        came = self.heard
        self.missed = 0 if came else self.missed + 1
        if self.is_commanded:
            self.commanded += 1
            self.unanswered += not came
            self.came.append(came)
        if self.is_strict and self.is_commanded and self.missed >= PATIENCE:
            self.abort(COMMUNICATION)

    def start_motion(self, *motion):
        self.last, self.missed = np.zeros(7), 0
        self.commanded = self.unanswered = 0
        self.came = deque(COUNTED * [True], COUNTED)
        super().start_motion(*motion)

    def _handle_udp_command(self, data):
        torque = np.frombuffer(data, "<f8", 7, TORQUE_OFFSET)
        self.heard, self.step = True, max(self.step, np.abs(torque - self.last).max())
        self.last = torque
        super()._handle_udp_command(data)

    def send_state(self):
        self.cycles += 1
        state = self.robot.inner_state
        self.trace[self.cycles % TRACED] = (
            1e-3 * self.cycles, *state.q, *state.dq, *self.robot.told, self.step, self.is_commanded)
        self.step = 0.0
        if self.drop or self.is_mute:
            self.drop = max(0, self.drop - 1)
            self._FrankaServer__message_id += 1  # the robot's time goes on
        elif self.is_served:
            super().send_state()
        else:
            FrankaServer.send_state(self)  # the arm's state, without the hand's

    @property
    def is_served(self):
        """Whether requests and the hand have their turn in this cycle, besides commands and states."""
        return self.cycles % SERVED_EVERY == 0

    @property
    def is_commanded(self):
        return self._FrankaRobotServer__control_mode is ControlMode.TORQUE

    def abort(self, error):
        """End the motion, as the robot does for this error."""
        motion = self.current_motion_id
        self.reset_current_motion_id()
        self.stop_motion(send_preemption_signal=False)
        self.error, self.missed = error, 0
        if motion:
            BaseCommand.send_response(self._tcp_socket, RobotCommand.kMove, motion, MoveStatus.kReflexAborted)

    @property
    def robot_state(self):
        state = super().robot_state.replace(
            control_command_success_rate=sum(self.came) / COUNTED if self.is_commanded else 0.0)
        if self.error is None:
            return state
        errors = tuple(i == self.error for i in range(41))
        return state.replace(robot_mode=RobotMode.kReflex, errors=errors, reflex_reason=errors)


class Server(SimulationServer):
    """A simulation of one such robot, which claims to speak this version of the protocol."""

    def __init__(self, simulator, protocol: int):
        super().__init__(simulator)
        self._protocol = protocol

    def init(self):
        robot = Robot(self.sim.robots[0], self._hostname_candidates)
        robot.protocol = self._protocol
        robot.init()
        self.robot_servers.append(robot)
        self.sim.start()


def greet(self, server: Robot, command_type_struct: str = "I") -> None:
    """What the robot does: a client that speaks another version is told which one it speaks itself."""
    if self.version == server.library_version:
        welcome(self, server, command_type_struct)
        return
    header = MessageHeader(self.command_type, self.command_id, 8).to_bytes(command_type_struct)
    status = ConnectStatus.kIncompatibleLibraryVersion
    layout = "<BH5x" if command_type_struct == "I" else "<HH4x"  # of the arm, of the hand
    self.client_socket.sendall(header + struct.pack(layout, status, server.library_version))


welcome = ConnectCommand.handle
ConnectCommand.handle = greet


def recover(self, server: Robot) -> None:
    """What the simulator's own command does, and the error is over."""
    server.error = None
    acknowledge(self, server)


acknowledge = AutomaticErrorRecoveryCommand.handle
AutomaticErrorRecoveryCommand.handle = recover


def answer(request: list[str], server: Server) -> dict:
    """Carry out one request."""
    robot = server.robot_servers[0]
    match request:
        case ["reflex"]:
            robot.abort(JOINT_REFLEX)
        case ["drop", number]:
            robot.drop = int(number)
        case ["mute" | "unmute" as wanted]:
            robot.is_mute = wanted == "mute"
        case ["strict" | "lenient" as wanted]:
            robot.is_strict = wanted == "strict"
        case ["trace", path]:
            rows = robot.trace[np.argsort(robot.trace[:, 0])]
            np.save(path, rows[rows[:, 0] > 0])
        case ["forget"]:
            robot.pause = 0.0
        case ["state"]:
            pass
        case _:
            raise ValueError(f"unknown request {request}")
    state = robot.robot.inner_state
    mode = RobotMode.kReflex if robot.error is not None else RobotMode.kMove if robot.current_motion_id \
        else RobotMode.kIdle
    return {"time": 1e-3 * robot.cycles, "q": state.q, "dq": state.dq, "mode": mode.name,
            "commanded": robot.commanded, "unanswered": robot.unanswered, "pause": robot.pause}


def lines(descriptor: int) -> Iterator[str | None]:
    """The lines that come, None where there is no whole one yet; ends with the input. Asked for between two
    cycles: a thread that waits for them would keep the interpreter when it is out of its turn."""
    os.set_blocking(descriptor, False)
    buffer = b""
    while True:
        try:
            received = os.read(descriptor, 65536)
        except BlockingIOError:
            yield None
            continue
        if not received:
            return
        *whole, buffer = (buffer + received).split(b"\n")
        yield from (line.decode() for line in whole)


def run(server: Server, requests: Iterator[str | None], period: float) -> None:
    """Cycles of `period` s of the machine's time, until the requests end. A late cycle makes those after it
    late: the robot's clock falls behind rather than hurrying after the machine's."""
    robot, due, before = server.robot_servers[0], time.monotonic(), time.monotonic()
    while True:
        server.run_once(realtime=False)
        now = time.monotonic()
        robot.pause, before = max(robot.pause, now - before), now
        if robot.is_served:
            try:
                line = next(requests)
            except StopIteration:
                return
            if line:
                print(json.dumps(answer(line.split(), server)), flush=True)
        due = max(due + period, time.monotonic())
        time.sleep(max(0.0, due - time.monotonic()))


def main() -> None:
    """Serve until standard input ends. Arguments: mass kg of the hand that the robot believes in; how many ms
    of the machine's time a cycle of 1 ms of the robot takes; version of the protocol that it claims."""
    mass, pace, protocol = map(float, sys.argv[1:])
    mujoco_simulator.FrankaMujocoRobot = SimulatedFr3
    with mujoco_simulator.MujocoSimulator() as simulator:
        simulator.add_robot(initial_q=READY, initial_hand_width=0.0, kp=HOLD_STIFFNESS, kv=HOLD_DAMPING,
                            robot_parameters=RobotParameters(ee_mass=mass))
        with Server(simulator, int(protocol)) as server:
            ctypes.CDLL(None).mlockall(LOCK_ALL)
            print(json.dumps({"hostname": server.sim.robots[0].hostname}), flush=True)
            run(server, lines(sys.stdin.fileno()), 1e-3 * pace)


if __name__ == "__main__":
    main()
