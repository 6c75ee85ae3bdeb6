"""The choice of a robot: a wrong one is refused by name, and what the original Panda's client needs besides
its package is tried on the FR3's protocol."""

from threading import Event

import numpy as np
import pytest

from np_franka.callback_loop import CallbackLoopAdapter
from np_franka.client import ConnectionLost, MotionAborted
from np_ros.processes.supervisor import NodeDied


@pytest.mark.parametrize("robot, protocol, spoken", [("fr3", 5, "panda"), ("panda", 10, "fr3")])
@pytest.mark.parametrize("gripper", [True, False])
def test_a_robot_of_the_other_kind_is_refused_with_both_names(
    start_robot, graph, probe, robot, protocol, spoken, gripper
):
    simulated, parameters = start_robot(protocol=protocol)
    graph.run("np_franka", "franka_driver", {**parameters, "robot": robot, "gripper": gripper})
    with pytest.raises(NodeDied, match="status 1") as died:
        probe.wait_until(lambda: False)
    for text in (f"robot:={robot}", f"version {protocol}", f"set robot:={spoken}", parameters["hostname"]):
        assert text in str(died.value)
    assert simulated.request("state")["mode"] == "kIdle"


def test_a_robot_of_no_known_kind_is_refused(graph, probe):
    graph.run("np_franka", "franka_driver", {"hostname": "127.0.0.1", "robot": "ur5"})
    with pytest.raises(NodeDied, match="status 1") as died:
        probe.wait_until(lambda: False)
    assert "robot: expected one of ['fr3', 'panda'], got 'ur5'" in str(died.value)


@pytest.fixture
def turnstile(start_robot):
    """The simulated robot, and a loop that calls back on its protocol, as libfranka 0.9 does on its own."""
    import pylibfranka as franka

    robot, parameters = start_robot()
    connection = franka.Robot(parameters["hostname"], franka.RealtimeConfig.kIgnore)

    def loop(callback):
        control, is_over = connection.start_torque_control(), False
        while not is_over:
            torques = callback(*control.readOnce())
            control.writeOnce(torques)
            is_over = torques.motion_finished

    yield robot, CallbackLoopAdapter(loop)


def torques(effort, *, last=False):
    import pylibfranka as franka

    answer = franka.Torques([0.0] * 6 + [effort])
    answer.motion_finished = last
    return answer


def test_a_loop_that_calls_back_is_read_and_written_in_turn(turnstile):
    robot, turn = turnstile
    first = turn.read()
    for _ in range(200):
        turn.write(torques(0.5))
        state = turn.read()
    assert state.time.to_sec() > first.time.to_sec() and state.q[6] > first.q[6] + 1e-3
    assert np.isclose(state.tau_J_d[6], 0.5)
    turn.finish(torques(0.0, last=True))
    assert robot.request("state")["mode"] == "kIdle"


def test_what_ends_the_loop_is_raised_by_the_next_read(turnstile):
    robot, turn = turnstile
    turn.read()
    robot.request("reflex")
    with pytest.raises(RuntimeError, match="joint_reflex"):
        while True:
            turn.write(torques(0.0))
            turn.read()


def test_an_abandoned_loop_ends(turnstile):
    robot, turn = turnstile
    turn.read()
    turn.abandon()
    with pytest.raises(RuntimeError, match="abandoned"):
        turn.read()


class Connection:
    """What panda_py's Robot is to the client, with a control loop that is given."""

    def __init__(self, loop):
        self.control = lambda callback, **_: loop(callback)

    def load_model(self):
        return None

    def read_once(self):
        """States still come."""


@pytest.fixture
def panda(monkeypatch):
    """A function that gives the original Panda's client under control, over a loop in place of libfranka's."""
    from np_franka import panda_client

    def controlled(loop):
        monkeypatch.setattr(panda_client.franka, "Robot", lambda *_: Connection(loop))
        client = panda_client.PandaClient("panda", enforce_realtime=False)
        client.start()
        return client

    return controlled


def wrong_type(_callback):
    raise TypeError("control(): incompatible function arguments")


@pytest.mark.parametrize("loop, words", [(wrong_type, "TypeError: control"), (lambda _: None, "has ended by itself")])
def test_a_motion_of_the_panda_that_ends_is_aborted_whatever_ended_it(panda, loop, words):
    client = panda(loop)
    with pytest.raises(MotionAborted, match=words):
        client.read()
    client.close()


def test_a_panda_that_neither_calls_back_nor_ends_is_lost(panda, monkeypatch):
    monkeypatch.setattr("np_franka.callback_loop.TIMEOUT", 0.05)
    over = Event()
    for ask in (lambda client: client.read(), lambda client: client.write(np.zeros(7), True)):
        client = panda(lambda _: over.wait())
        with pytest.raises(ConnectionLost, match="connection to panda: .* within 0.05 s"):
            ask(client)
        client.close()
    over.set()
