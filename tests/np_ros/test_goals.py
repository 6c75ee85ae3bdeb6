"""The goal in the diagnostics of `episode`, which tells a late subscriber the goal in force."""

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from np_description.domains import CARD, sample_task
from np_ros.goals import GOAL, episode_goal, goal_text
from np_ros.messages import pose_message


def diagnostics_of(text: str, node: str = "/lab/episode") -> DiagnosticArray:
    status = DiagnosticStatus(name=node, values=[KeyValue(key="phase", value="pre"), KeyValue(key=GOAL, value=text)])
    return DiagnosticArray(status=[status])


def test_the_goal_in_the_diagnostics_reads_back():
    _, goal = sample_task(CARD, np.random.default_rng(1))
    text = goal_text(pose_message(1_500_000_000, "panda_link0", goal.position, goal.quaternion))
    found = episode_goal(diagnostics_of(text))
    np.testing.assert_allclose(found.position, goal.position, atol=1e-4)
    np.testing.assert_allclose(found.quaternion, goal.quaternion, atol=1e-4)
    assert episode_goal(diagnostics_of(text, "/sim_bridge")) is None


@pytest.mark.parametrize("text", ["", "none", "0.1 m, x", "a b c m, 1 0 0 0, at 3 ns"])
def test_a_text_without_a_goal_is_none(text):
    assert episode_goal(diagnostics_of(text)) is None
