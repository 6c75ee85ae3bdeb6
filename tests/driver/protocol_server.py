"""A simulated FR3 that speaks libfranka's protocol on a loopback address, with faults on request.

Run by simulated_robot.py in the simulator's own environment, which has nothing of this project. It is
franky-sim's server; added are the faults that it does not simulate itself. Standard input takes one request a
line and standard output gives one JSON object for each: `state`; `drop N`: keep the next N states to itself;
`reflex`: abort the motion as a collision does, until automatic error recovery. The first line out is
{"hostname": ...}.
"""

from __future__ import annotations

import json
import queue
import sys
import threading

from franky_sim import SimulationServer
from franky_sim.base_simulator import RobotParameters
from franky_sim.franka_robot_protocol import (
    AutomaticErrorRecoveryCommand, MoveStatus, RobotCommand, RobotMode)
from franky_sim.franka_robot_server import FrankaRobotServer
from franky_sim.franka_server import BaseCommand
from franky_sim.mujoco_simulator import MujocoSimulator

READY = (0.0, -0.785398, 0.0, -2.356194, 0.0, 1.570796, 0.785398)
# The robot's own hold while nobody controls it. franky-sim's gains chatter for ever after a stop from speed.
HOLD_STIFFNESS = (600.0, 600.0, 600.0, 600.0, 250.0, 150.0, 50.0)  # Nm/rad
HOLD_DAMPING = (50.0, 50.0, 50.0, 50.0, 30.0, 25.0, 15.0)  # Nms/rad
JOINT_REFLEX = 6  # index of joint_reflex among libfranka's 41 errors


class Robot(FrankaRobotServer):
    """franky-sim's robot, which can also lose states and abort motions."""

    reflex = False
    drop = 0  # states that are still to be lost

    def send_state(self):
        if self.drop:
            self.drop -= 1
            self._FrankaServer__message_id += 1  # the robot's time goes on
        else:
            super().send_state()

    def abort(self):
        """End the motion as a joint reflex does."""
        motion = self.current_motion_id
        self.reset_current_motion_id()
        self.stop_motion(send_preemption_signal=False)
        self.reflex = True
        if motion:
            BaseCommand.send_response(self._tcp_socket, RobotCommand.kMove, motion, MoveStatus.kReflexAborted)

    @property
    def robot_state(self):
        state = super().robot_state
        if not self.reflex:
            return state
        errors = tuple(i == JOINT_REFLEX for i in range(41))
        return state.replace(robot_mode=RobotMode.kReflex, errors=errors, reflex_reason=errors)


class Server(SimulationServer):
    """A simulation of one such robot."""

    def init(self):
        robot = Robot(self.sim.robots[0], self._hostname_candidates)
        robot.init()
        self.robot_servers.append(robot)
        self.sim.start()


def recover(self, server: Robot) -> None:
    """What the simulator's own command does, and the reflex is over."""
    server.reflex = False
    acknowledge(self, server)


acknowledge = AutomaticErrorRecoveryCommand.handle
AutomaticErrorRecoveryCommand.handle = recover


def answer(request: list[str], server: Server) -> dict:
    """Carry out one request."""
    robot = server.robot_servers[0]
    if request == ["reflex"]:
        robot.abort()
    elif request[0] == "drop":
        robot.drop = int(request[1])
    elif request != ["state"]:
        raise ValueError(f"unknown request {request}")
    state = robot.robot_state
    return {"q": state.q, "dq": state.dq, "tau_J": state.tau_J, "mode": state.robot_mode.name}


def main() -> None:
    """Serve until standard input ends. The argument: mass of the hand that the robot believes in, kg."""
    requests: queue.SimpleQueue[str] = queue.SimpleQueue()

    def listen():
        for line in sys.stdin:
            requests.put(line)
        requests.put("")

    with MujocoSimulator() as simulator:
        simulator.add_robot(initial_q=READY, initial_hand_width=0.0, kp=HOLD_STIFFNESS, kv=HOLD_DAMPING,
                            robot_parameters=RobotParameters(ee_mass=float(sys.argv[1])))
        with Server(simulator) as server:
            threading.Thread(target=listen, daemon=True).start()
            print(json.dumps({"hostname": server.sim.robots[0].hostname}), flush=True)
            while True:
                server.run_once()
                if not requests.empty():
                    line = requests.get()
                    if not line:
                        return
                    print(json.dumps(answer(line.split(), server)), flush=True)


if __name__ == "__main__":
    main()
