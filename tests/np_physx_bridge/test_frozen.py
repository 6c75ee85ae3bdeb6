"""The engine is frozen: what it makes of a push is pinned, and goes with its version."""

import numpy as np
import pytest

from np_control.kinematics import forward_kinematics, jacobian
from np_description.domains import BUMP
from np_physx_bridge.engine import VERSION, PhysxEngine
from np_physx_bridge.library import missing
from np_sim_bridge.simulation import Simulation

pytestmark = pytest.mark.skipif(bool(missing()), reason=missing() or "PhysX is here")

PUSHED = {
    "3": [-0.12353, 0.41958, -0.10369, -2.13817, -0.10539, 2.55114, 0.78333, 0.0, 0.0]
    + [0.55942, -0.14557, 0.045, 0.25318, -0.0, 0.0, -0.96742]
}
"""Generalised positions after the push, of this version. Another behaviour is another version."""


@pytest.fixture(scope="module")
def pushed():
    """The cube after the hand was driven down onto it and along x, 25 N at most; and what pressed in every period.

    A change of torques by 1e-7 of themselves changes the end by 1e-4.
    """
    simulation, touches = Simulation(BUMP, seed=3, engine=PhysxEngine), []
    goal = simulation.object_pose().position + [0, 0, -0.01]
    for period in range(600):
        measured = simulation.measure()
        q, dq = measured.position[:7], measured.velocity[:7]
        ahead = [0.03 * max(0, period - 350) / 250, 0, 0]
        force = 400 * (goal + ahead - forward_kinematics(q)[0])
        force *= min(1, 25 / np.linalg.norm(force))
        simulation.step(jacobian(q)[:3].T @ force - 3 * dq)
        touches.append((simulation.engine.pressing(), np.linalg.norm(simulation.wrench[:3])))
    return simulation.configuration(), touches


def test_a_push_ends_where_this_version_has_it(pushed):
    np.testing.assert_allclose(pushed[0], PUSHED[VERSION], atol=1e-3)


def test_what_presses_is_named_and_gives_the_force_that_the_joints_feel(pushed):
    pressing = [found for found, _ in pushed[1]]
    assert {name for found in pressing for name in found} == {"finger"} and {} in pressing
    solved, felt = np.array([(found.get("finger", 0.0), estimated) for found, estimated in pushed[1]]).T
    assert felt.sum() == pytest.approx(solved.sum(), rel=0.1)
