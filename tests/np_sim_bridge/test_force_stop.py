"""The force reflex of a simulated arm, in a loop as a bridge has it."""

import numpy as np
import pytest
from sim2real.effects.patch import Patch, PatchEffect

from np_control.kinematics import jacobian
from np_control.safety import Refusal, SafetyFilter, State
from np_description.domains import CARD
from np_description.force_reflex import FORCE_REFLEX, OBSERVE, STOP
from np_description.panda import JOINT_NAMES, NOMINAL
from np_sim_bridge.simulation import Simulation

DOWN = np.array([0.0, 0.0, -60.0, 0.0, 0.0, 0.0])  # N


class Loop:
    """An arm that is commanded downwards, with its guards."""

    def __init__(self, mode):
        self.simulation, self.guard = Simulation(CARD, force_reflex=mode), SafetyFilter()
        self.guard.start(self.measured.position[:7])

    @property
    def measured(self):
        return self.simulation.measure()

    def push(self):
        """One period; Refusal where no command is taken."""
        now = self.measured
        q, dq = now.position[:7], now.velocity[:7]
        torque = jacobian(q).T @ DOWN - 2 * dq
        self.guard.offer(now.stamp, JOINT_NAMES, q, dq, torque, now=now.stamp)
        self.step()

    def step(self):
        now = self.measured
        self.simulation.step(self.guard.apply(now.stamp, now.position[:7], now.velocity[:7]).torque)
        if self.simulation.reflex:
            self.guard.fault(self.simulation.reflex)


def test_a_stop_is_a_fault_the_arm_comes_to_rest_and_moves_again_only_when_it_has_recovered():
    loop = Loop(STOP)
    with pytest.raises(Refusal, match="fault"):
        for _ in range(1000):
            loop.push()
    assert loop.guard.state is State.FAULT and loop.guard.watchdog.cause.startswith("reflex: force")
    assert loop.simulation.force.figures.reflex_stops["40"] == 1
    while not loop.guard.at_rest:
        loop.step()
    stood = loop.measured.position[:7]
    for _ in range(250):
        loop.step()
        with pytest.raises(Refusal):
            loop.push()
    assert np.abs(loop.measured.position[:7] - stood).max() < 0.02
    loop.guard.recover(loop.measured.position[:7])
    assert loop.guard.state is State.READY
    loop.push()
    assert loop.guard.state is State.MOVING


def test_who_observes_counts_the_stop_and_goes_on():
    loop = Loop(OBSERVE)
    while loop.simulation.force.figures.force_n["max"] <= FORCE_REFLEX.force:
        loop.push()
    assert loop.guard.state is State.MOVING and loop.simulation.reflex == ""
    figures = loop.simulation.force.figures
    assert figures.reflex_stops["40"] == 1 and figures.body == "finger" and figures.raw_peak_n > FORCE_REFLEX.force
    loop.simulation.reset(1, loop.simulation.stamp)
    assert loop.simulation.force.figures.force_n["max"] == 0.0 and not loop.simulation.wrench.any()


@pytest.mark.parametrize("friction", [0.0, 2.0])
def test_friction_that_a_patch_adds_to_a_joint_is_no_external_force(friction):
    effects = (PatchEffect("coulomb_friction", JOINT_NAMES[6], {"level": friction}),) if friction else ()
    simulation = Simulation(CARD, patch=Patch(effects))
    torque = np.zeros(7)
    torque[6] = NOMINAL.frictionloss[6] + friction + 0.3
    for _ in range(200):
        simulation.step(torque)
    assert simulation.measure().velocity[6] > 0.1
    assert np.linalg.norm(simulation.wrench[:3]) < 1.0
