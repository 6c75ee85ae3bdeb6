"""A simulated FR3 that speaks libfranka's protocol on a loopback address, with faults on request.

Run by simulated_robot.py in the simulator's own environment, which has nothing of this project. It is
franky-sim's server with the robot of faulty_robot.py. Standard input takes one request a line and standard
output gives one JSON object for each, `state` and whatever else was asked:

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
import sys
import time
from collections.abc import Iterator

import numpy as np
from faulty_robot import JOINT_REFLEX, Robot
from franky_sim import SimulationServer, mujoco_simulator
from franky_sim.base_simulator import RobotParameters
from franky_sim.franka_robot_protocol import RobotMode
from simulated_fr3 import SimulatedFr3

READY = (0.0, -0.785398, 0.0, -2.356194, 0.0, 1.570796, 0.785398)
# The robot's own hold while nobody controls it. franky-sim's gains chatter for ever after a stop from speed.
HOLD_STIFFNESS = (600.0, 600.0, 600.0, 600.0, 250.0, 150.0, 50.0)  # Nm/rad
HOLD_DAMPING = (50.0, 50.0, 50.0, 50.0, 30.0, 25.0, 15.0)  # Nms/rad
LOCK_ALL = 1 | 2  # MCL_CURRENT and MCL_FUTURE of mlockall(2)


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
    mode = (
        RobotMode.kReflex
        if robot.error is not None
        else RobotMode.kMove
        if robot.current_motion_id
        else RobotMode.kIdle
    )
    return {
        "time": 1e-3 * robot.cycles,
        "q": state.q,
        "dq": state.dq,
        "mode": mode.name,
        "commanded": robot.commanded,
        "unanswered": robot.unanswered,
        "pause": robot.pause,
    }


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
        simulator.add_robot(
            initial_q=READY,
            initial_hand_width=0.0,
            kp=HOLD_STIFFNESS,
            kv=HOLD_DAMPING,
            robot_parameters=RobotParameters(ee_mass=mass),
        )
        with Server(simulator, int(protocol)) as server:
            ctypes.CDLL(None).mlockall(LOCK_ALL)
            print(json.dumps({"hostname": server.sim.robots[0].hostname}), flush=True)
            run(server, lines(sys.stdin.fileno()), 1e-3 * pace)


if __name__ == "__main__":
    main()
