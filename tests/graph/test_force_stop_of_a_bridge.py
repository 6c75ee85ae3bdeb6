"""The force reflex of a bridge: what it publishes, and the fault that only `recover` ends."""

import json
import sys
from pathlib import Path

import numpy as np
from geometry_msgs.msg import WrenchStamped

from np_control.force_watch import read_figures
from np_control.kinematics import jacobian
from np_description.force_reflex import FORCE_REFLEX
from np_description.message_arrays import stamp_nanoseconds, wrench_array
from np_description.panda import BASE_FRAME
from np_evaluation.conformance.harness import Harness, TestedBackend

sys.path.insert(0, str(Path(__file__).parents[1] / "contract"))

from backends import stay  # noqa: E402


def down(state):
    """Push with 60 N down, slowed by the joints' speed."""
    q, dq = np.array(state.position[:7]), np.array(state.velocity[:7])
    return stay(state, effort=list(jacobian(q).T @ [0, 0, -60, 0, 0, 0] - 2 * dq))


def test_a_bridge_that_stops_is_at_fault_until_it_has_recovered_and_says_the_force(graph, probe):
    wrenches = probe.collect("external_wrench", WrenchStamped)
    harness = Harness(probe, TestedBackend("sim_bridge"))
    graph.run(
        "np_sim_bridge",
        "sim_bridge",
        {"mode": "lockstep", "tick_barrier": False, "camera": False, "force_reflex": "stop"},
    )
    harness.meet()
    harness.follow(down, lambda: harness.status.get("state") == "fault", "the reflex")
    assert "reflex: force" in harness.message
    harness.wait(lambda: harness.call("recover").success, "the arm to come to rest and to recover")
    harness.wait(lambda: harness.status.get("state") == "ready", "the recovered state")
    figures = read_figures(harness.status["external_force"])
    assert figures.reflex_stops["40"] == 1 and figures.body == "finger"
    forces = {stamp_nanoseconds(w.header.stamp): wrench_array(w, BASE_FRAME) for w in wrenches}
    assert max(np.linalg.norm(w[:3]) for w in forces.values()) > FORCE_REFLEX.force
    assert set(forces) <= {stamp_nanoseconds(s.header.stamp) for s in harness.states} | {min(forces)}
    assert json.loads(harness.status["external_force"])["force_n"]["max"] > FORCE_REFLEX.force
