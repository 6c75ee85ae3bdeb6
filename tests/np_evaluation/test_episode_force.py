"""The external force in episodes: the robot's estimate against the contact solver, and what a row says."""

from dataclasses import asdict

import mujoco
import numpy as np
import pytest

from np_control import external_force
from np_control.kinematics import jacobian
from np_description.contact.depths import PUSHERS
from np_description.contact.penetration import kind_of
from np_description.domains import WALL
from np_description.force_reflex import FORCE_REFLEX, STOP, ForceReflex, filter_step, hand_wrench
from np_description.mujoco_engine import MujocoEngine
from np_evaluation.in_process import InProcessRollout
from np_evaluation.scoring import summary
from np_sim_bridge.simulation import Simulation

PERIOD = 0.002


class Solved(MujocoEngine):
    """MuJoCo, which keeps the torque (7,) Nm that its contacts put on the arm's joints, and where the arm was."""

    episode = []

    def step(self, torque, extra, opening):
        q = self.joints()[0][:7]
        super().step(torque, extra, opening)
        self.episode.append((q, self._of_contacts()))

    def _of_contacts(self):
        model, data = self.model, self.data
        total, wrench, rows = np.zeros(7), np.zeros(6), np.zeros((3, model.nv))
        for number, contact in enumerate(data.contact):
            for side, geom in zip((-1, 1), contact.geom):
                if kind_of(model.geom(geom).name) not in PUSHERS:
                    continue
                mujoco.mj_contactForce(model, data, number, wrench)
                force = side * contact.frame.reshape(3, 3).T @ wrench[:3]
                mujoco.mj_jac(model, data, rows, None, contact.pos, model.geom_bodyid[geom])
                total += (rows.T @ force)[self._velocity[:7]]
        return total


@pytest.fixture(scope="module")
def played():
    """A result, the estimated wrenches (n, 6) and those of the contact solver, filtered alike."""
    Solved.episode = []
    estimated = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("np_evaluation.in_process.MujocoEngine", Solved)
        step = Simulation.step

        def kept(self, torque):
            step(self, torque)
            estimated.append(self.wrench)

        patch.setattr(Simulation, "step", kept)
        result = InProcessRollout(WALL, "mujoco", seed=5).play(0)
    filtered, true = np.zeros(6), []
    for q, torque in Solved.episode:
        filtered = filter_step(filtered, hand_wrench(torque, jacobian(q)), PERIOD)
        true.append(filtered)
    return result, np.array(estimated), np.array(true)


def test_the_estimate_follows_the_contact_solver_to_what_joint_friction_hides(played):
    result, estimated, true = played
    assert len(estimated) == len(true) and np.linalg.norm(true[:, :3], axis=1).max() > 10
    error = np.linalg.norm(estimated[:, :3] - true[:, :3], axis=1)
    assert np.median(error) < 0.5 and error.max() < 3.0


def test_a_row_says_the_force_the_body_and_the_stops_and_a_summary_those_of_all(played):
    result, estimated, _ = played
    figures = result.force
    largest = np.linalg.norm(estimated[:, :3], axis=1).max()
    assert figures["force_n"]["max"] == pytest.approx(largest, abs=0.01) and figures["raw_peak_n"] > largest
    assert figures["body"] in PUSHERS and figures["reflex_stops"]["25"] >= figures["reflex_stops"]["40"]
    assert result.engine == "mujoco" and result.engine_version == f"mujoco {mujoco.__version__}"
    found = summary([result, result])
    assert found["force_n"]["max"] == round(figures["force_n"]["max"], 1) and found["reflex_stops"]["40"] == 2 * bool(
        figures["reflex_stops"]["40"]
    )
    assert asdict(result)["force"] == figures


def test_a_stop_ends_the_episode_as_a_fault(played, monkeypatch):
    """With a fifth of the force's threshold: the released policy presses with less than the whole."""
    fifth = ForceReflex(FORCE_REFLEX.torque, FORCE_REFLEX.force / 5, FORCE_REFLEX.moment)
    monkeypatch.setattr(external_force, "FORCE_REFLEX", fifth)
    stopped = InProcessRollout(WALL, "mujoco", seed=5, force_reflex=STOP).play(0)
    assert not stopped.success and stopped.declared == stopped.failed_in == "fault"
    assert stopped.reason.startswith("reflex: force") and stopped.duration < played[0].duration
    assert fifth.force < stopped.force["force_n"]["max"] < played[0].force["force_n"]["max"]
