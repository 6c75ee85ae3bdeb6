"""The task suite: its plans keep the limits, effects of the scene change what they state, and touches find the surface."""

import numpy as np
import pytest
from sim2real.effects import SCENE_EFFECTS
from sim2real.effects.patch import Patch, PatchEffect, dump_patch, load_patch
from sim2real.excitation.contact_suite.contact_motions import DEEPER, SLOW, touch
from sim2real.excitation.contact_suite.monitor import OutOfPicture, SuiteMonitor
from sim2real.excitation.contact_suite.suite import FAMILIES, SuiteState, sides_with_room, task_suite
from sim2real.excitation.contact_suite.tip import BEYOND, CORNERS, EDGE, RADIUS, leading_yaw, upright_rotation
from sim2real.excitation.contact_suite.tip_path import Leg, OutOfReach, join_segments, make_segment, tip_position
from sim2real.excitation.contact_suite.workspace import RestingObject, Workspace

from np_common.rotations import yaw_quaternion
from np_control.impedance import STIFFNESS_MAX
from np_control.kinematics import forward_kinematics, jacobian
from np_description.camera import CAMERA
from np_description.domains import BUMP, WALL, Pose
from np_description.hand import FLAT_HAND
from np_description.panda import NOMINAL
from np_sim_bridge.simulation import Simulation

LAIN = Pose(np.array([0.5, -0.14, 0.045]), yaw_quaternion(np.asarray(0.2)))


def scene(effect, **parameters):
    return Patch((PatchEffect(effect, str(SCENE_EFFECTS[effect].target), parameters),))


def plans(only=()):
    generator = task_suite(BUMP, SuiteState(NOMINAL.ready, LAIN), only)
    plan = next(generator)
    while plan:
        yield plan
        lowest = 0.09 if plan[-1].name == "touch_object" else 0.0
        try:
            plan = generator.send(SuiteState(plan[-1].positions[-1], LAIN, lowest))
        except StopIteration:
            return


def test_every_family_is_planned_and_segments_join():
    made = list(plans())
    names = [plan[-1].name for plan in made]
    assert {name.rsplit("_", 1)[0] if name not in FAMILIES else name for name in names} == set(FAMILIES) - {
        "sway"
    }  # a cube would rock
    q = NOMINAL.ready
    for plan in made:
        for one in plan:
            assert np.allclose(one.positions[0], q, atol=1e-6)
            assert one.trajectory.duration > 0  # raises Refusal where the controller would refuse it
            q = one.positions[-1]
    assert sum(one.duration for plan in made for one in plan) < 185


@pytest.mark.parametrize(("x", "y"), [(0.43, -0.17), (0.54, -0.14), (0.5, 0.1)])
def test_the_housing_passes_a_tall_object_beside_which_the_table_is_touched(x, y):
    lain = RestingObject.of(BUMP, Pose(np.array([x, y, 0.045]), yaw_quaternion(np.asarray(0.3))))
    places = Workspace(BUMP, CAMERA).touch_places(lain)
    corners = lain.corners(np.zeros(2))[:, :2]
    housing = np.max([box.half_size[:2] for box in FLAT_HAND.housing], axis=0)
    assert len(places) == 4
    for place in places:  # the hand's y is across the table
        assert (corners.max(axis=0) < place - housing).any() or (corners.min(axis=0) > place + housing).any()


@pytest.mark.parametrize("y", [-0.13, 0.0, 0.09])
def test_the_housing_passes_a_wall_beside_which_the_table_is_touched(y):
    """At its edge the tip was clear of the wall, and the hand pressed on it with 56 N."""
    places = Workspace(WALL, CAMERA).touch_places(RestingObject.of(WALL, Pose(np.array([0.53, y, 0.05]), np.eye(4)[0])))
    (wall,) = WALL.obstacles
    housing = np.max([box.half_size[:2] for box in FLAT_HAND.housing], axis=0)
    assert len(places) == 4
    for place in places:
        assert (np.abs(place - wall.centre[:2]) > housing + wall.half_size[:2]).any()


def test_an_object_that_has_left_the_picture_is_told_from_one_that_no_pose_explains():
    scattered = np.column_stack([np.random.default_rng(1).uniform(0, 200, (8, 2)), np.ones(8)])
    seen = np.column_stack([CAMERA.project(RestingObject.of(BUMP, LAIN).corners(np.zeros(2)))[0], np.ones(8)])
    for changed, error in ((seen * ([[1, 1, 0]] * 3 + [[1, 1, 1]] * 5), OutOfPicture), (scattered, ValueError)):
        witness = SuiteMonitor(BUMP)
        witness.add_keypoints(1, changed)
        with pytest.raises(error) as raised:
            witness.state(NOMINAL.ready)
        assert isinstance(raised.value, OutOfPicture) == (error is OutOfPicture)


def test_an_unknown_family_is_refused_by_name():
    with pytest.raises(ValueError, match="'drags': expected one of view"):
        task_suite(BUMP, SuiteState(NOMINAL.ready, LAIN), ["drags"])


def test_a_path_leads_the_tip_straight_and_out_of_reach_is_said():
    begin, end = np.array([0.5, 0.1, 0.13]), np.array([0.5, 0.1, 0.03])
    made = make_segment("down", begin, [Leg(end, 0.1)], 0.3)
    tips = np.array([tip_position(q) for q in made.positions])
    assert np.allclose(tips[:, :2], begin[:2], atol=1e-3) and tips[-1, 2] == pytest.approx(0.03, abs=5e-4)
    assert np.allclose(forward_kinematics(made.positions[-1])[1], upright_rotation(0.3), atol=5e-3)
    with pytest.raises(OutOfReach, match="far: the tip cannot be at"):
        make_segment("far", np.array([1.2, 0.0, 0.1]), [Leg(np.array([1.2, 0.0, 0.05]), 0.1)], 0.0)


@pytest.mark.parametrize("place", [(0.42, -0.13), (0.42, 0.3), (0.5, -0.14), (0.6, 0.0)])
def test_a_touch_finds_the_arm_no_stiffer_for_what_it_did_before(place):
    """The elbow stays over the line from the base to the tip; aside, 8 mm below a surface press with 113 N."""
    q, elsewhere = NOMINAL.ready, [np.array([x, y]) for y in (-0.3, 0.3) for x in (0.62, 0.42)]
    for before in elsewhere:
        q = join_segments(q, [touch("before", before, 0.0, 0.0)])[-1].positions[-1]
    made = join_segments(q, [touch("touch", np.array(place), 0.0, 0.0)])[-1]
    deepest = min(made.positions, key=lambda q: tip_position(q)[2])
    linear = jacobian(deepest)[:3]
    lead = np.array([0.0, 0.0, -DEEPER])
    assert abs(deepest[2]) < 0.2
    assert np.linalg.norm(np.linalg.solve(linear / STIFFNESS_MAX @ linear.T, lead)) < 50  # N
    assert np.linalg.svd(linear, compute_uv=False)[-1] > 0.2  # m, the least lever


@pytest.mark.parametrize("angle", np.linspace(-3, 3, 7))
def test_an_edge_leads(angle):
    ahead = np.array([np.cos(angle), np.sin(angle)])
    along = (CORNERS @ upright_rotation(leading_yaw(ahead)).T)[:, :2] @ ahead
    assert along.max() == pytest.approx(np.linalg.norm(CORNERS[0, :2]), abs=1e-9)


def test_scene_effects_are_read_back_and_carried(tmp_path):
    assert Patch().scene_change() == scene("object_mass", relative=0.0).scene_change()
    both = Patch((*scene("table_height", height=0.01).effects, *scene("object_mass", relative=0.5).effects))
    path = tmp_path / "patch.yaml"
    path.write_text(dump_patch(both))
    simulation = Simulation(BUMP, scenario=1, patch=load_patch(path))
    for _ in range(200):
        simulation.step(np.zeros(7))
    assert simulation.object_pose().position[2] == pytest.approx(0.055, abs=2e-4)
    model = simulation.model
    assert model.body_mass[model.body("object").id] == pytest.approx(1.5 * BUMP.mass)
    change = scene("table_friction", relative=0.5).scene_change()
    assert change.contact(BUMP.contact).table == pytest.approx(0.6)


def touched(height, families):
    """Plans of a suite over a table at `height` m, on which the tip stops."""
    generator, lowest = task_suite(BUMP, SuiteState(NOMINAL.ready, LAIN), families), None
    plan = next(generator)
    while plan:
        yield plan
        lowest = max(min(tip_position(q)[2] for q in plan[-1].positions), height)
        try:
            plan = generator.send(SuiteState(plan[-1].positions[-1], LAIN, lowest))
        except StopIteration:
            return


@pytest.mark.parametrize(
    ("height", "plans"),
    [(0.0, 4), (0.015, 4), (-0.0079, 5), pytest.param(-0.015, 6, marks=pytest.mark.slow), (-0.05, 12)],
)
def test_a_table_is_felt_for_deeper_until_the_tip_is_stopped(height, plans):
    made = [plan[-1] for plan in touched(height, ["touch_table"])]
    assert len(made) == plans
    depths = [min(tip_position(q)[2] for q in one.positions) for one in made]
    if height > -0.03:  # what was felt first tells the other places
        assert depths[-1] == pytest.approx(height - DEEPER, abs=1e-3) and len({one.name for one in made}) == 4
    assert min(depths) > -0.026


@pytest.mark.parametrize("angle", np.linspace(-3, 3, 7))
def test_a_pushed_face_is_met_by_the_pads_edge_alone(angle):
    """Down to `EDGE` below the object's top, no part of a finger is ahead of the edge that leads."""
    ahead, turn = (
        np.array([np.cos(angle), np.sin(angle), 0.0]),
        upright_rotation(leading_yaw(np.array([np.cos(angle), np.sin(angle)]))),
    )
    shaft, slide = FLAT_HAND.shaft, BEYOND - FLAT_HAND.tip.centre[2] - FLAT_HAND.tip.half_size[2]
    for side in (-1.0, 1.0):
        along = np.linspace(-1, 1, 200)[:, None]
        axis = (np.array(shaft.centre) + along * np.array(shaft.half_axis)) * [1.0, side, 1.0] + [0.0, 0.0, slide]
        above = axis @ turn.T - turn @ [0.0, 0.0, BEYOND]
        wide = (
            shaft.radius**2 - np.maximum(above[:, 2] - EDGE, 0.0) ** 2
        )  # of each sphere, at the object's top or below
        reaches = (above @ ahead + np.sqrt(np.maximum(wide, 0.0)))[wide > 0]
        assert len(reaches) and reaches.max() < RADIUS


def test_an_object_at_the_edge_of_its_room_is_first_pushed_to_where_more_sides_have_some():
    edge = Pose(np.array([0.5, -0.195, 0.045]), yaw_quaternion(np.asarray(0.2)))
    lain, room = RestingObject.of(BUMP, edge), Workspace(BUMP, CAMERA)
    before = len(sides_with_room(room, lain, SLOW))
    plan = next(task_suite(BUMP, SuiteState(NOMINAL.ready, edge), ["push"]))[-1]
    tips = np.array([tip_position(q) for q in plan.positions])
    low = tips[tips[:, 2] < tips[:, 2].min() + 1e-3]
    way = low[np.linalg.norm(low - low[0], axis=1).argmax()] - low[0]
    travel = way[:2] * (1 - SLOW.run_up / np.linalg.norm(way[:2]))
    assert plan.name == "push_10" and len(sides_with_room(room, lain.shift(travel), SLOW)) > before


def test_a_tip_that_has_tapped_draws_back_at_once_and_one_that_has_pushed_rests():
    """Else it comes to rest no sooner than the object, and holds it: where that lies then says nothing."""

    def rests(family):
        plan = next(plans for plans in touched(0.0, [family]) if plans[-1].name == f"{family}_1")[-1]
        away = np.linalg.norm(
            [tip_position(q)[:2] - tip_position(plan.positions[0])[:2] for q in plan.positions], axis=1
        )
        return float(np.diff(plan.times[away > away.max() - 5e-4][[0, -1]])[0])

    assert rests("tap") < 0.06 and rests("push") > 0.5
