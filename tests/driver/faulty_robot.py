"""franky-sim's robot with what it does not simulate itself: faults, the refusal of another protocol, and a
record of what the arm really did. In the simulator's own environment; a part of protocol_server.py.
"""

from __future__ import annotations

import struct
from collections import deque

import numpy as np
from franky_sim.franka_robot_protocol import AutomaticErrorRecoveryCommand, MoveStatus, RobotCommand, RobotMode
from franky_sim.franka_robot_server import ControlMode, FrankaRobotServer
from franky_sim.franka_server import BaseCommand, ConnectCommand, ConnectStatus, FrankaServer, MessageHeader

# joint_reflex and communication_constraints_violation among libfranka's 41 errors
JOINT_REFLEX, COMMUNICATION = 6, 25
PATIENCE = 20  # cycles without a command: FCI documentation, "Network bandwidth, delay and jitter test"
TRACED = 100_000  # cycles
SERVED_EVERY = 4  # cycles from one look at requests, and at the hand, to the next
COUNTED = 100  # cycles of which the robot tells the share that brought a command
TORQUE_OFFSET = 8 + 38 * 8 + 2  # bytes, of tau_J_d in a command: UDPCommand.STRUCT of franky-sim


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
            1e-3 * self.cycles,
            *state.q,
            *state.dq,
            *self.robot.told,
            self.step,
            self.is_commanded,
        )
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
            control_command_success_rate=sum(self.came) / COUNTED if self.is_commanded else 0.0
        )
        if self.error is None:
            return state
        errors = tuple(i == self.error for i in range(41))
        return state.replace(robot_mode=RobotMode.kReflex, errors=errors, reflex_reason=errors)


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
