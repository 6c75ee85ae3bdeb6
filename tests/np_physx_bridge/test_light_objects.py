"""What is light between an arm and a table, in the second engine: it has as many steps as friction takes to come to what Coulomb says."""

import mujoco
import numpy as np
import pytest

from np_description.contact.model import HARD
from np_physx_bridge.library import missing, sapien
from np_physx_bridge.scene import Translator, count_substeps, scene
from np_sim_bridge.schedule import PERIOD, SECOND

GRAVITY = 9.81
HAND = """<mujoco><worldbody>
  <geom name="table" type="plane" size="1 1 .1" friction=".4" contype="1" conaffinity="6"/>
  <body name="object" pos="0 0 .0025"><freejoint/>
    <geom name="object" type="box" size=".025 .035 .0025" mass="{mass}" friction=".1" contype="2" conaffinity="5"/></body>
  <body name="hand"><inertial pos="0 0 0" mass="1" diaginertia=".01 .01 .01"/>
    <body name="go"><joint name="go" type="slide" axis="1 0 0" range="-1 1"/><inertial pos="0 0 0" mass="1" diaginertia=".001 .001 .001"/>
      <body name="lift"><joint name="lift" type="slide" axis="0 0 1" range="-1 1"/><inertial pos="0 0 0" mass="1" diaginertia=".001 .001 .001"/>
        <geom name="left_tip" type="box" size=".0087 .0072 .00885" pos="0 .0122 .01395" contype="4" conaffinity="3"/>
        <geom name="right_tip" type="box" size=".0087 .0072 .00885" pos="0 -.0122 .01395" contype="4" conaffinity="3"/>
      </body></body></body>
</worldbody></mujoco>"""


def resistance(mass: float, load: float, steps: int, speed: float = 0.003, seconds: float = 1.0) -> float:
    """Force along its way, N, with which a card resists pads that press it and draw it along: the mean of the last third."""
    model, library = mujoco.MjModel.from_xml_string(HAND.format(mass=mass)), sapien()
    period = PERIOD / SECOND
    world, _ = scene(library, period / steps)
    translator = Translator(library, model, HARD)
    (*hand,), articulation, _ = translator.articulation("hand")
    card, _ = translator.free_body("object")
    card.set_pose(library.Pose([0, 0, 0.0025]))
    for entity in (translator.surroundings(), card, *hand):
        world.add_entity(entity)
    forces = []
    for step in range(round(seconds / period) * steps):
        gone = max(0.0, step * period / steps - 0.3)
        (place, *_), (going, lifting, *_) = articulation.get_qpos(), articulation.get_qvel()
        forces.append(1e5 * (speed * gone - place) + 900 * (speed * (gone > 0) - going))
        press = load * min(step * period / steps / 0.1, 1) + 20 * lifting
        articulation.set_qf(np.array([forces[-1], -press, *np.zeros(articulation.dof - 2)], dtype=np.float32))
        world.step()
    return float(np.mean(forces[-len(forces) // 3 :]))


@pytest.mark.skipif(bool(missing()), reason=missing() or "PhysX is here")
@pytest.mark.parametrize("mass, load", [(0.008, 10.0), (0.005, 10.0), (0.001, 3.0)])
def test_what_is_drawn_slowly_resists_by_the_law_of_coulomb(mass, load):
    """In one step of 2 ms, as before, 8 g resist by .96 of it, 5 g by .87, 1 g by .76: a pass of the solver hands its mass times a speed on."""
    law = HARD.table * (load + mass * GRAVITY)
    assert resistance(mass, load, count_substeps(mass, is_rigid=True)) == pytest.approx(law, rel=0.03)


def test_only_what_is_light_has_more_steps_than_the_bridge_asks_for():
    assert [count_substeps(mass, is_rigid=True) for mass in (0.38, 0.03, 0.016, 0.01, 0.008, 0.005, 0.001)] == [
        1
    ] * 4 + [
        2,
        2,
        4,
    ]
    assert [count_substeps(mass, is_rigid=False) for mass in (0.03, 0.009, 0.005, 0.001)] == [1, 2, 2, 2]
