"""What breaks at the robot reaches the episode: phase `fault`, and no start until it is over."""

from backends import silent
from diagnostic_msgs.msg import DiagnosticArray

from np_ros import qos
from np_ros.phases import phase_state


def test_a_reflex_is_a_fault_of_the_episode_until_recover(start_robot, start_driver):
    robot, parameters = start_robot()
    harness = start_driver(parameters)
    phases = harness.probe.collect("episode/phase", DiagnosticArray, qos.LATCHED)
    names = {
        harness.graph.run("np_policy", "episode", {"mode": "realtime", "backend": "franka_driver", "silence": 300.0})
    }
    harness.probe.wait_until_ready(names)
    assert harness.probe.call("episode/start").success
    harness.wait(lambda: phases and phase_state(phases[-1]).phase == "pre", "the phase before")
    robot.request("reflex")
    harness.wait(lambda: phase_state(phases[-1]).phase == "fault", "the phase of a fault")
    assert "joint_reflex" in phase_state(phases[-1]).reason
    response = harness.probe.call("episode/start")
    assert not response.success and "joint_reflex" in response.message
    harness.answer = silent
    while not (response := harness.call("recover")).success:
        assert "still moves" in response.message, response.message
    harness.wait_state("ready")
    assert harness.probe.call("episode/start").success
    harness.wait(lambda: phase_state(phases[-1]).phase == "pre", "the next episode")
