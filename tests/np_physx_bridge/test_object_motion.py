"""Objects that are not rigid, in both engines: they rest, bear a push by the fingers, and what is inside slides."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from np_common.rotations import matrix_from_quaternion
from np_control.kinematics import forward_kinematics, solve_ik
from np_description.contact.model import CONTACTS, HARD
from np_description.domains import DOMAINS, Pose, resting_pose
from np_description.mujoco_engine import MujocoEngine
from np_description.objects.choice import domain_with, place_object
from np_description.objects.spec import Contents
from np_description.objects.table import ROWS, rows_of
from np_description.panda import NOMINAL
from np_physx_bridge.engine import PhysxEngine
from np_physx_bridge.library import missing, sapien
from np_physx_bridge.scene import Translator
from np_planning.collision import CollisionModel
from np_sim_bridge.simulation import Simulation

ENGINES = {
    "mujoco": MujocoEngine,
    "physx": pytest.param(PhysxEngine, marks=pytest.mark.skipif(bool(missing()), reason=missing() or "PhysX is here")),
}
in_both = pytest.mark.parametrize("engine", ENGINES.values(), ids=ENGINES)
# Of a definition the second engine takes coefficients of friction only: one will do.
in_both_contacts = pytest.mark.parametrize(
    "engine, contact",
    [(MujocoEngine, contact) for contact in CONTACTS.values()]
    + [pytest.param(*ENGINES["physx"].values, HARD, marks=ENGINES["physx"].marks)],
    ids=[*CONTACTS, "physx"],
)
SOFT = [(row.spec.domain, row.spec.name) for row in ROWS if not row.spec.is_rigid]
every_soft_one = pytest.mark.parametrize("domain, name", SOFT, ids=map("-".join, SOFT))
PLATED = [(row.spec.domain, row.spec.name) for row in ROWS if row.spec.compliance]
in_physx = pytest.mark.skipif(bool(missing()), reason=missing() or "PhysX is here")
ZERO, FLAT = np.zeros(7), np.array([1.0, 0, 0, 0])


def travel(domain) -> float:
    """How far a face gives way, m."""
    return domain.object.compliance.travel if domain.object.compliance else 0.0


@in_both_contacts
@every_soft_one
def test_it_comes_to_rest_where_it_is_put(engine, contact, domain, name):
    domain = domain_with(domain, name)
    made = engine(domain, contact=contact)
    start = resting_pose(domain, domain.start, np.mean(domain.start.x), np.mean(domain.start.y), 0.0, 0.0, 0.0)
    made.reset(start)
    for _ in range(400):
        made.step(ZERO, ZERO, 0.0)
    before = made.configuration()
    for _ in range(100):
        made.step(ZERO, ZERO, 0.0)
    pose = made.object_pose()
    assert np.abs(made.configuration() - before)[9:].max() < 2e-5
    assert 0 <= start.position[2] - pose.position[2] < 0.2 * travel(domain) + 1.5e-4
    assert np.abs(pose.position - start.position)[:2].max() < 5e-4
    assert abs(pose.quaternion @ start.quaternion) > 1 - 1e-6


def drawn(engine, domain, contact, *, depth=None, beside=(0.0, 0.0), along=(0.03, 0.0)):
    """Positions (n, 3) of the object and the deepest that a part went beyond its travel, m, while a fingertip comes down on it,
    `beside` its middle, presses, draws it `along` a way, m, and leaves it; depth m: of the press; None: a little more than it gives way."""
    start, stiffness = np.array([0.5, 0.1, domain.half_size[2]]), 200.0
    _, rotation = forward_kinematics(NOMINAL.ready)
    top, depth = 2 * domain.half_size[2], 0.0012 + travel(domain) if depth is None else depth
    over, low = (np.array([*(start[:2] + beside), z]) for z in (top + 0.015, top - depth))
    joints = [solve_ik(NOMINAL.ready, over, rotation)]
    for target in (low, low, low + [*along, 0.0], over + [*along, 0.02]):
        joints.append(solve_ik(joints[-1], target, rotation))
    made = engine(domain, panda=replace(NOMINAL, ready=joints[0]), contact=contact)
    made.reset(Pose(start, FLAT))
    ranges = made.model.jnt_range[made.model.joint("object").id + 1 :]
    positions, beyond = [], 0.0
    for a, b, periods in zip(joints, joints[1:], (300, 100, 300, 200)):
        for k in range(periods):
            q, dq, _ = made.joints()
            torque = stiffness * (a + (b - a) * (k + 1) / periods - q[:7]) - 1.4 * np.sqrt(stiffness) * dq[:7]
            made.step(torque, ZERO, 0.0)
            parts = made.configuration()[16:]
            positions.append(made.object_pose().position)
            beyond = max(beyond, *(ranges[:, 0] - parts), *(parts - ranges[:, 1])) if len(parts) else beyond
    return np.array(positions), beyond


@in_physx
def test_the_lightest_soft_card_follows_a_tip_as_in_the_other_engine():
    """1 g between a table and an arm: what a solver does not come to the end of, holds it fast under the tip, and makes it leap."""
    domain = replace(domain_with("card", "tissue"), obstacles=())
    how = {"depth": 0.02, "beside": (0.025, 0.0), "along": (0.0, 0.05)}
    there, here = (drawn(engine, domain, HARD, **how)[0] for engine in (MujocoEngine, PhysxEngine))
    assert there[399, 0] - there[0, 0] > 0.02  # pushed by the hand that comes down beside its middle
    assert np.abs(here - there)[[399, 699, 899]].max() < 0.005
    assert here[:, 2].max() < domain.half_size[2] + 5e-4


@in_physx
@pytest.mark.parametrize("mass", [0.001, 0.0025])
def test_a_hand_that_presses_hard_does_not_go_through_what_is_light(mass):
    """In steps of 2 ms 72 passes of the solver hand 20 N through 8 g, not through 1 g: the tip stood 6 mm deep in such a card, did not move it and
    threw it up by 14 mm when it left. With more steps it is drawn along as in MuJoCo."""
    rigid = replace(domain_with("card", "tissue").object, mass=mass, compliance=None)
    domain = replace(place_object(DOMAINS["card"], rigid), obstacles=())
    there, here = (drawn(engine, domain, HARD, depth=0.02)[0] for engine in (MujocoEngine, PhysxEngine))
    assert there[699, 0] - there[0, 0] > 0.04
    assert np.abs(here - there)[[399, 699, 899]].max() < 0.01
    assert here[:, 2].max() < domain.half_size[2] + 5e-4


def pressed():
    """Engine, contact, domain and object. In the second engine each takes 4 to 9 s: one that gives way and one with something inside
    are quick, and the lightest of all has tests of its own above."""
    for domain, name in SOFT:
        for contact in CONTACTS:
            yield pytest.param(MujocoEngine, CONTACTS[contact], domain, name, id=f"{domain}-{name}-{contact}")
        is_quick = (domain, name) in (("bump", "sponge"), ("wall", "water_tissue_box"))
        marks = [*ENGINES["physx"].marks, *[pytest.mark.slow] * (not is_quick)]
        yield pytest.param(PhysxEngine, HARD, domain, name, id=f"{domain}-{name}-physx", marks=marks)


@pytest.mark.parametrize("engine, contact, domain, name", pressed())
def test_it_bears_being_pressed_and_drawn(engine, contact, domain, name):
    domain = replace(domain_with(domain, name), obstacles=())
    positions, beyond = drawn(engine, domain, contact)
    assert np.isfinite(positions).all()
    rest, pressed = domain.half_size[2], positions[300:400, 2]
    # A wall's box is tall: pressed beside its middle, an edge of it lifts. A shell hardly sinks, and not at all into a hard table.
    tips = 0.002 if domain.name == "wall" else -2e-5 if domain.object.compliance else 0.0
    assert rest - travel(domain) - 0.0012 < pressed.min() < rest + tips  # MuJoCo's default contact sinks by 1 mm itself
    assert beyond < 0.001
    assert abs(positions[-1, 2] - rest) < 0.005
    if domain.name != "wall":
        assert 0.01 < positions[-1, 0] - positions[0, 0] < 0.05


@in_both
def test_what_is_loose_falls_to_the_lower_end_and_stays_where_the_box_lies(engine):
    spec = replace(rows_of("wall")["default"].spec, contents=Contents(0.02, (0.0, 0.0, 0.01), 0.3))
    half = np.sqrt(0.5)
    upright, upside_down, lying = FLAT, np.array([0, 1.0, 0, 0]), np.array([half, 0, half, 0])
    for quaternion, height, expected in ((upright, 0.05, -0.01), (upside_down, 0.05, 0.01), (lying, 0.025, 0.0)):
        made = engine(replace(place_object(DOMAINS["wall"], spec), obstacles=()), contact=HARD)
        made.reset(Pose(np.array([0.5, 0.1, height]), quaternion))
        for _ in range(400):
            made.step(ZERO, ZERO, 0.0)
        assert made.configuration()[16:] == pytest.approx([expected], abs=2e-4)
        assert abs(made.object_pose().quaternion @ quaternion) > 1 - 1e-6


@in_both
def test_the_bridge_sees_the_core_and_draws_every_part(engine):
    simulation = Simulation(domain_with("wall", "water_tissue_box"), scenario=2, seed=1, engine=engine)
    for _ in range(20):
        simulation.step(ZERO)
    configuration, pose = simulation.configuration(), simulation.object_pose()
    assert configuration.shape == (simulation.model.nq,) == (23,)
    np.testing.assert_array_equal(configuration[9:16], [*pose.position, *pose.quaternion])
    data = mujoco.MjData(simulation.model)
    data.qpos[:] = configuration
    mujoco.mj_kinematics(simulation.model, data)
    np.testing.assert_allclose(data.body("object").xpos, pose.position)


def test_the_planner_keeps_clear_of_the_box_that_is_there():
    spec = replace(rows_of("bump")["sponge"].spec, size=(0.1, 0.09, 0.08))
    model = CollisionModel(place_object(DOMAINS["bump"], spec)).model
    assert model.nq == 16 and model.geom("object").size == pytest.approx([0.05, 0.045, 0.04])


@in_both
def test_a_soft_object_is_a_function_of_seed_episode_and_torques(engine):
    domain = domain_with("bump", "sponge")
    fresh = Simulation(domain, seed=4, first_episode=2, engine=engine)
    used = Simulation(domain, seed=4, first_episode=7, engine=engine)
    for i in range(40):
        used.step(10 * np.sin(np.arange(7) + i))
    used.reset(2, used.stamp)
    for i in range(100):
        for simulation in (fresh, used):
            simulation.step(5 * np.cos(np.arange(7) * i) + [0, 8, 0, 0, 0, 0, 0])  # into the box
        np.testing.assert_array_equal(fresh.configuration(), used.configuration())


def push_part(made, name: str, force: list[float]) -> None:
    """A force, N, in the base frame, at the middle of a part, for the next step; PhysX forgets it after the first of its own."""
    if isinstance(made, MujocoEngine):
        made.data.xfrc_applied[made.model.body(name).id, :3] = force
        return
    links = {link.joint.name: link for link in made.object.articulation.get_links()}
    links[name].add_force_torque(made._substeps * np.array(force), [0, 0, 0])


@in_both
@pytest.mark.parametrize("domain, name", PLATED, ids=map("-".join, PLATED))
def test_a_soft_row_gives_way_as_its_stiffness_says(engine, domain, name):
    """Its upper face is pressed flat, by what sinks each of the two plates in a row by half its travel."""
    domain = replace(domain_with(domain, name), obstacles=())
    soft = domain.object.compliance
    made, load = engine(domain, contact=HARD), soft.stiffness * soft.travel
    made.reset(Pose(np.array([0.5, 0.1, domain.half_size[2]]), FLAT))
    first = made.model.joint("object").id + 1
    upper, lower = (made.model.joint(f"object_{side}_z").id - first for side in ("upper", "lower"))
    for _ in range(500):
        push_part(made, "object_upper_z", [0.0, 0.0, -load])
        made.step(ZERO, ZERO, 0.0)
    parts, weight = made.configuration()[16:], 9.81 * domain.object.mass / (2 * soft.stiffness)
    assert -parts[upper] == pytest.approx(soft.travel / 2, rel=0.05, abs=2e-5)
    assert parts[lower] == pytest.approx(min(soft.travel / 2 + weight, soft.travel), rel=0.05, abs=2e-5)


@in_physx
@pytest.mark.parametrize("spec", [row.spec for row in ROWS], ids=[f"{row.spec.domain}-{row.spec.name}" for row in ROWS])
def test_a_row_weighs_and_rubs_in_the_second_engine_as_it_says(spec):
    engine = PhysxEngine(place_object(DOMAINS[spec.domain], spec))
    engine.reset(Pose(np.array([0.5, -0.2, spec.half_size[2]]), FLAT))
    bodies = [engine.object] if spec.is_rigid else engine.object.articulation.get_links()
    places = [body.entity.pose * body.cmass_local_pose for body in bodies]
    masses, centres = np.array([body.mass for body in bodies]), np.array([place.p for place in places], float)
    centre = masses @ centres / masses.sum()
    inertia = np.zeros((3, 3))
    for body, place, at in zip(bodies, places, centres - centre):
        turn = matrix_from_quaternion(np.asarray(place.q, float))
        inertia += turn @ np.diag(body.inertia) @ turn.T + body.mass * (at @ at * np.eye(3) - np.outer(at, at))
    assert masses.sum() == pytest.approx(spec.mass, rel=1e-5)
    np.testing.assert_allclose(centre - engine.object_pose().position, spec.centre_of_mass, atol=1e-6)
    np.testing.assert_allclose(inertia, np.diag(spec.moments), atol=1e-3 * max(spec.moments))
    table = Translator(sapien(), engine.model, engine._contact).surroundings().components[0]
    (pad,) = (link for link in engine.articulation.get_links() if link.joint.name == "panda_finger1_tip")
    tip = pad.get_collision_shapes()[-1]
    touching = [shape for body in bodies for shape in body.get_collision_shapes()]
    outermost = np.max([np.abs((body.entity.pose * shape.get_local_pose()).p - engine.object_pose().position)
                        + (shape.half_size if hasattr(shape, "half_size") else shape.radius)
                        for body in bodies for shape in body.get_collision_shapes()], axis=0)  # fmt: skip
    np.testing.assert_allclose(outermost, spec.half_size, atol=1e-6)
    for shape in touching:  # PhysX averages the two of a pair
        for other, friction in ((table.get_collision_shapes()[0], spec.surface.table), (tip, spec.surface.finger)):
            pair = shape.physical_material.static_friction + other.physical_material.static_friction
            assert pair / 2 == pytest.approx(friction.coefficient, rel=1e-6)


@in_physx
def test_the_second_engine_has_the_same_masses_and_springs():
    domain = domain_with("wall", "water_tissue_box")
    engine = PhysxEngine(domain)
    engine.reset(Simulation(domain).task.start)
    links = engine.object.articulation.get_links()
    assert sum(link.mass for link in links) == pytest.approx(domain.object.mass, rel=1e-5)
    joints = {joint.name: joint for joint in engine.object.articulation.get_active_joints()}
    for name, joint in joints.items():
        number = engine.model.joint(name).id
        dof = engine.model.jnt_dofadr[number]
        assert joint.stiffness == pytest.approx(engine.model.jnt_stiffness[number])
        assert joint.armature[0] == pytest.approx(engine.model.dof_armature[dof])
        np.testing.assert_allclose(joint.limits[0], engine.model.jnt_range[number], rtol=1e-6)
    assert joints["object_inside_z"].force_limit == pytest.approx(0.3 * 0.12 * 9.81, rel=1e-5)
