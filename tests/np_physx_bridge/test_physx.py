"""The second engine: the same arm and the same coefficients as in MuJoCo, by masses, motion and materials."""

import sys
from dataclasses import replace

import numpy as np
import pytest
from sim2real.effects.patch import Patch, PatchEffect

from np_description.contact.model import HARD, RUBBER_STIFFNESS
from np_description.domains import BUMP, CARD, DOMAINS, WALL
from np_description.mujoco_engine import MujocoEngine
from np_description.panda import BASE_FRAME, JOINT_NAMES, NOMINAL, STATE_NAMES
from np_description.scene import OBJECT, TIP, load_model
from np_physx_bridge.engine import PhysxEngine
from np_physx_bridge.library import missing, sapien
from np_physx_bridge.scene import ALONG, PAD_JOINTS, PAD_MASS, SHEAR, Translator, coefficient
from np_physx_bridge.shapes import CORE, RECESS, RODS
from np_sim_bridge.schedule import PERIOD
from np_sim_bridge.simulation import Simulation

pytestmark = pytest.mark.skipif(bool(missing()), reason=missing() or "PhysX is here")
ZERO = np.zeros(7)


def swing(engine, panda=NOMINAL, substeps=1):
    """Joint angles after half a second of the same torques, and how far they went."""
    simulated = engine(CARD, panda=panda, substeps=substeps)
    simulated.reset(Simulation(CARD, seed=1).task.start)
    for i in range(250):
        simulated.step(3 * np.sin(0.02 * i + np.arange(7)), ZERO, 0.0)
    return simulated.joints()[0][:7]


def links_of_the_scene(engine):
    """The arm's links but for those of the pads, which are no bodies of the scene."""
    return [link for link in engine.articulation.get_links() if f"_{TIP}" not in link.joint.name]


def test_masses_frames_and_inertia_are_those_of_the_scene():
    engine = PhysxEngine(BUMP)
    engine.reset(Simulation(BUMP).task.start)
    model, links = engine.model, links_of_the_scene(engine)
    # Base, seven links, hand, two fingers; three links for each of two pads.
    assert len(links) == 11 == len(engine.articulation.get_links()) - 2 * len(PAD_JOINTS)
    first = model.body(BASE_FRAME).id
    for body, link in enumerate(links, start=first):
        name = model.body(body).name
        pad, place = (PAD_MASS, model.geom(f"{name}_tip").pos) if "finger" in name else (0.0, np.zeros(3))
        assert link.mass + pad == pytest.approx(model.body_mass[body])
        moment = link.mass * link.cmass_local_pose.p + pad * place
        np.testing.assert_allclose(link.inertia, model.body_inertia[body], rtol=1e-6)
        np.testing.assert_allclose(moment, model.body_mass[body] * model.body_ipos[body], atol=1e-7)
    assert all(link.disable_gravity for link in engine.articulation.get_links())
    assert engine.object.mass == pytest.approx(BUMP.mass)
    np.testing.assert_allclose(engine.object.inertia, model.body_inertia[model.body(OBJECT).id], rtol=1e-6)


def test_a_link_stands_where_it_stands_in_mujoco():
    physx, other = Simulation(WALL, engine=PhysxEngine), Simulation(WALL)
    other.engine.model.opt.timestep = 1e-9  # only for the frames
    for simulation in (physx, other):
        simulation.step(ZERO)
    first = other.model.body(BASE_FRAME).id
    for body, link in enumerate(links_of_the_scene(physx.engine), start=first):
        np.testing.assert_allclose(link.entity.pose.p, other.engine.data.xpos[body], atol=1e-6)


@pytest.mark.parametrize(
    "joint, force",
    [("panda_finger1_tip_along", 10.0), ("panda_finger1_tip_across", -10.0), ("panda_finger1_tip", 10.0)],
)
def test_a_pad_gives_way_in_three_directions_by_rubbers_stiffness(joint, force):
    """Pushed for ten of its time constants of 12 ms; 8 % less far, for the engine adds an outer force before its passes."""
    engine = PhysxEngine(WALL)
    engine.reset(Simulation(WALL).task.start)
    joints = engine.articulation.get_active_joints()
    (number,) = (k for k, found in enumerate(joints) if found.name == joint)
    for _ in range(60):
        pushed = np.zeros(len(joints), dtype=np.float32)
        pushed[number] = force
        engine.articulation.set_qf(pushed)
        engine._system.step()
    stiffness = RUBBER_STIFFNESS * (1.0 if joint.endswith(ALONG) else SHEAR)
    assert engine.articulation.get_qpos()[number] == pytest.approx(force / stiffness, rel=0.1)


def test_rigid_bodies_move_as_in_mujoco():
    """Without friction, which the engines regularise differently, and damping, in steps of half a millisecond."""
    bare = replace(NOMINAL, frictionloss=ZERO, damping=ZERO)
    there, here = (swing(engine, bare, substeps=4) for engine in (MujocoEngine, PhysxEngine))
    assert np.abs(there - NOMINAL.ready).max() > 1.0
    # Half a thousandth of a radian after 1.5 of swinging: pads on stiff springs take more of the iterations than rigid fingers (2e-4).
    np.testing.assert_allclose(here, there, atol=6e-4)


def test_the_arm_with_friction_moves_as_in_mujoco_but_for_how_it_sticks():
    there, here = swing(MujocoEngine), swing(PhysxEngine)
    np.testing.assert_allclose(here, there, atol=8e-3)


@pytest.mark.parametrize("domain", DOMAINS.values(), ids=DOMAINS)
def test_arm_and_object_rest_without_torque(domain):
    simulation = Simulation(domain, seed=1, engine=PhysxEngine)
    start = simulation.task.start
    for _ in range(250):
        simulation.step(ZERO)
    assert simulation.measure().stamp == 250 * PERIOD
    assert np.abs(simulation.measure().position[:7] - NOMINAL.ready).max() < 1e-6
    pose = simulation.object_pose()
    assert np.linalg.norm(pose.position - start.position) < 1e-5
    assert abs(pose.quaternion @ start.quaternion) > 1 - 1e-9


def test_a_joint_sticks_below_its_friction_and_accelerates_by_what_is_above():
    joint, friction = 6, NOMINAL.frictionloss[6]
    simulation, torque = Simulation(CARD, engine=PhysxEngine), np.zeros(7)
    torque[joint] = 0.99 * friction
    for _ in range(100):
        simulation.step(torque)
    np.testing.assert_allclose(simulation.measure().effort[:7], torque)
    assert abs(simulation.measure().position[joint] - NOMINAL.ready[joint]) < 1e-6
    torque[joint] = 2 * friction
    for _ in range(100):
        simulation.step(torque)
    other = Simulation(CARD)
    for _ in range(100):
        other.step(torque)
    speed, same = simulation.measure().velocity[joint], other.measure().velocity[joint]
    assert same > 0.1 and speed == pytest.approx(same, rel=5e-3)


def test_fingers_open_as_told():
    simulation = Simulation(CARD, engine=PhysxEngine)
    simulation.set_fingers(0.03)
    for _ in range(350):
        simulation.step(ZERO)
    np.testing.assert_allclose(simulation.measure().position[7:], 0.03, atol=1e-5)


def test_what_the_renderer_draws_is_the_state():
    simulation = Simulation(BUMP, seed=3, engine=PhysxEngine)
    simulation.step(np.full(7, 2.0))
    configuration, pose = simulation.configuration(), simulation.object_pose()
    assert configuration.shape == (simulation.model.nq,)
    joints = [simulation.model.joint(name).qposadr[0] for name in STATE_NAMES]
    np.testing.assert_array_equal(configuration[joints], simulation.measure().position)
    at = simulation.model.joint(OBJECT).qposadr[0]
    np.testing.assert_array_equal(configuration[at : at + 7], [*pose.position, *pose.quaternion])


def test_the_state_is_a_function_of_seed_episode_and_torques():
    fresh = Simulation(BUMP, seed=4, first_episode=2, engine=PhysxEngine)
    used = Simulation(BUMP, seed=4, first_episode=7, engine=PhysxEngine)
    for i in range(60):
        used.set_fingers(0.03)
        used.step(10 * np.sin(np.arange(7) + i))
    used.reset(2, used.stamp)
    for i in range(200):
        torque = 5 * np.cos(np.arange(7) * i) + [0, 8, 0, 0, 0, 0, 0]  # into the box
        for simulation in (fresh, used):
            simulation.step(torque)
        np.testing.assert_array_equal(fresh.configuration(), used.configuration())
        np.testing.assert_array_equal(fresh.measure().velocity, used.measure().velocity)


def test_effects_of_a_patch_work_alike_for_they_are_outside_of_the_engine():
    delayed = Patch((PatchEffect("command_delay", "arm", {"delay": 0.02}),))
    late, prompt = (Simulation(CARD, engine=PhysxEngine, patch=patch) for patch in (delayed, Patch()))
    torque = np.array([0, 0, 0, 0, 0, 0, 1.0])
    for k in range(18):
        late.step(torque * (k >= 10))
        prompt.step(torque * (k >= 10))
    assert abs(late.measure().velocity[6]) < 1e-6 < 1e-2 < prompt.measure().velocity[6]


def test_divergence_is_an_error():
    simulation = Simulation(CARD, engine=PhysxEngine)
    simulation.engine.object.set_linear_velocity([np.nan] * 3)
    with pytest.raises(FloatingPointError, match="diverged at 2000000 ns: object not finite"):
        simulation.step(ZERO)


def test_pairs_have_the_coefficients_of_the_definition():
    """PhysX averages the two of a pair."""

    def pair(a, b, **which):
        one = coefficient(HARD, a, is_object=which.get("object", False))
        return (one + coefficient(HARD, b, is_object=False)) / 2

    for partner in (HARD.table, HARD.finger, HARD.housing, HARD.links):
        assert pair(0.1, partner, object=True) == pytest.approx(partner)
    assert pair(HARD.finger, HARD.table) == pytest.approx(max(HARD.finger, HARD.table))


def test_shapes_have_material_and_collision_bits_of_the_scene():
    model = load_model(BUMP, contact=HARD)
    component = Translator(sapien(), model, HARD).surroundings().components[0]
    shapes = component.get_collision_shapes()
    assert len(shapes) == 1 + len(BUMP.obstacles)
    for shape in shapes:
        assert shape.physical_material.static_friction == pytest.approx(HARD.table)
        is_plane = isinstance(shape, sapien().physx.PhysxCollisionShapePlane)
        assert shape.get_collision_groups() == [1, 6, int(is_plane), 0]
    assert sum(shape.get_collision_groups()[2] for shape in shapes) == 1


def test_the_object_stands_on_corners_and_edges_and_the_arm_touches_its_faces():
    model = load_model(BUMP, contact=HARD)
    box, *others = Translator(sapien(), model, HARD).free_body(OBJECT)[1].get_collision_shapes()
    *rods, core = others[: 12 * RODS + 1]
    corners = others[12 * RODS + 1 :]
    assert box.get_collision_groups() == [0, 4, 0, 0] and len(corners) == 8
    for rod in rods:
        outermost = np.abs(rod.get_local_pose().p) + rod.radius
        assert rod.get_collision_groups() == [0, 1, 1, 0]
        assert np.isclose(outermost, np.array(BUMP.half_size) - RECESS, atol=1e-7).sum() == 2
    assert sum(2 * (rod.half_length + rod.radius) for rod in rods) == pytest.approx(12 * 2 * BUMP.half_size[0])
    assert core.get_collision_groups() == [0, 1, 1, 0]
    np.testing.assert_allclose(core.half_size, np.array(BUMP.half_size) - CORE, atol=1e-7)
    for corner in corners:
        assert corner.get_collision_groups() == [0, 1, 0, 0]
        outermost = np.abs(corner.get_local_pose().p) + corner.radius
        np.testing.assert_allclose(outermost, BUMP.half_size, atol=1e-7)


def test_where_it_is_not_installed_the_error_names_the_command(monkeypatch):
    monkeypatch.setitem(sys.modules, "sapien", None)  # as if it were not there
    assert "`make physx` installs" in missing()
    with pytest.raises(OSError, match="expected the package sapien, which `make physx` installs"):
        PhysxEngine(CARD)


def test_joint_names_lead_to_the_joints_of_the_same_name():
    engine = PhysxEngine(CARD)
    engine.reset(Simulation(CARD).task.start)
    for i in range(len(JOINT_NAMES)):
        torque = np.zeros(7)
        torque[i] = 20 * NOMINAL.frictionloss[i]
        engine.reset(Simulation(CARD).task.start)
        engine.step(torque, ZERO, 0.0)
        assert np.argmax(np.abs(engine.joints()[1][:7])) == i
