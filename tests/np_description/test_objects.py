"""Objects as data: the rows of the paper's table, files of one's own, and what the compiled scene makes of them."""

import re
from dataclasses import fields, replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from np_description.contact.model import CONTACTS, HARD, SOFT
from np_description.contact.penetration import Penetration
from np_description.domains import BUMP, CARD, DOMAINS, WALL, is_lost, sample_task
from np_description.objects.choice import domain_with, embed_object_text, find_object, place_object, read_domain
from np_description.objects.files import ObjectError, object_text, parse_object, read_object
from np_description.objects.parts import split_object
from np_description.objects.scenarios import COUNT, make_fixed_task
from np_description.objects.spec import Contents, Friction, ObjectSpec, Softness, Surface
from np_description.objects.table import BASELINES, ROWS, SURFACES, TRIES, rows_of
from np_description.scene import OBJECT, load_model

SPECS = {f"{row.spec.domain}-{row.spec.name}": row.spec for row in ROWS}
every_row = pytest.mark.parametrize("spec", SPECS.values(), ids=SPECS)
TEXT = """
name: tea box
domain: card
size: [0.06, 0.07, 0.006]  # m
mass: 0.012                # kg
surface: paper
"""


def whole(model: mujoco.MjModel) -> tuple[float, np.ndarray, np.ndarray]:
    """Mass, centre of mass and inertia (3, 3) about it of the object with its parts, in its frame, in a compiled scene."""
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    first, origin = model.body(OBJECT).id, data.body(OBJECT).xpos
    bodies = [body for body in range(model.nbody) if model.body_rootid[body] == first]
    masses, centres = model.body_mass[bodies], data.xipos[bodies] - origin
    mass = masses.sum()
    centre = masses @ centres / mass
    inertia = np.zeros((3, 3))
    for body, m, place in zip(bodies, masses, centres - centre):
        turn = data.ximat[body].reshape(3, 3)
        inertia += turn @ np.diag(model.body_inertia[body]) @ turn.T + m * (
            place @ place * np.eye(3) - np.outer(place, place)
        )
    return mass, centre, inertia


def structure(model: mujoco.MjModel) -> tuple:
    """What a scene consists of, without sizes and weights."""
    return (
        *(getattr(model, name) for name in ("nq", "nv", "nu", "nbody", "ngeom", "njnt")),
        [model.geom(i).name for i in range(model.ngeom)],
        [model.body(i).name for i in range(model.nbody)],
        *(
            getattr(model, name).tolist()
            for name in ("geom_type", "geom_contype", "geom_conaffinity", "geom_group", "jnt_type")
        ),
    )


def assert_is(model: mujoco.MjModel, spec: ObjectSpec) -> None:
    mass, centre, inertia = whole(model)
    assert mass == pytest.approx(spec.mass, rel=1e-9)
    np.testing.assert_allclose(centre, spec.centre_of_mass, atol=1e-8)  # the compiler takes less for none
    np.testing.assert_allclose(inertia, np.diag(spec.moments), atol=1e-6 * max(spec.moments))


@every_row
def test_the_compiled_object_weighs_what_its_row_says(spec):
    assert_is(load_model(place_object(DOMAINS[spec.domain], spec)), spec)


@every_row
def test_a_rigid_row_has_the_structure_of_the_domains_own_object(spec):
    own, other = load_model(DOMAINS[spec.domain]), load_model(place_object(DOMAINS[spec.domain], spec))
    assert (structure(other) == structure(own)) == spec.is_rigid
    assert structure(load_model(place_object(DOMAINS[spec.domain], spec).as_rigid_box)) == structure(own)


@every_row
@pytest.mark.parametrize("contact", CONTACTS.values(), ids=CONTACTS)
def test_the_table_carries_all_of_it(spec, contact):
    model = load_model(place_object(DOMAINS[spec.domain], spec), contact=contact)
    data, force, carried = mujoco.MjData(model), np.zeros(6), 0.0
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_step(model, data, 500)
    for number, contact_point in enumerate(data.contact):
        if model.geom("table").id in contact_point.geom:
            mujoco.mj_contactForce(model, data, number, force)
            carried += force[0]
    assert carried == pytest.approx(9.81 * spec.mass, rel=2e-3)


@given(
    size=st.tuples(*[st.floats(0.02, 0.2)] * 3),
    mass=st.floats(0.005, 1.5),
    shift=st.tuples(*[st.floats(-0.3, 0.3)] * 3),
    soft=st.booleans(),
    inside=st.sampled_from([(), (0,), (0, 1), (0, 1, 2)]),
)
@settings(max_examples=25, deadline=None)
def test_any_box_is_compiled_as_it_is_described(size, mass, shift, soft, inside):
    half = np.array(size) / 2
    clearance = [0.4 * half[axis] if axis in inside else 0.0 for axis in range(3)]
    spec = ObjectSpec(
        "any",
        "bump",
        size,
        mass,
        SURFACES["paper"],
        centre_of_mass=tuple((np.array(shift) * half).tolist()),
        # Not loose in a box whose centre of mass is elsewhere: that may leave no room for what is inside.
        compliance=Softness(2000.0, 0.1 * min(size)) if soft else None,
        contents=Contents(max(0.3 * mass, 0.0005), tuple(clearance), 0.3) if inside else None,
    )
    try:
        split_object(spec)
    except ValueError as error:
        assert "room for the moving parts" in str(error)
        return
    assert_is(load_model(place_object(BUMP, spec)), spec)


def test_the_default_is_what_there_was():
    """Not another object that equals it: the domain itself, so that nothing that follows from it can differ."""
    for name, domain in DOMAINS.items():
        assert domain_with(name) is domain_with(name, "default") is domain and domain.object is None
        assert read_domain({"domain": name}) is domain and embed_object_text(name, "default") == "default"
        own = load_model(domain)
        assert own.nq == 16 and own.body(OBJECT).mass[0] == pytest.approx(domain.mass, rel=1e-12)
        row = load_model(place_object(domain, rows_of(name)["default"].spec))
        assert structure(row) == structure(own)
        for values in ("geom_friction", "geom_size", "geom_solref", "geom_solimp", "body_mass", "jnt_range"):
            np.testing.assert_allclose(getattr(row, values), getattr(own, values), rtol=1e-12)


def test_the_rows_are_the_papers():
    masses = {name: [round(1e3 * row.spec.mass) for row in rows_of(name).values()] for name in DOMAINS}
    assert masses == {
        "card": [8, 8, 16, 8, 5, 1, 9],
        "bump": [146, 146, 223, 381, 381, 30, 102],
        "wall": [38, 38, 62, 97, 97, 5, 138],
    }
    assert {name: [row.successes for row in rows_of(name).values()] for name in DOMAINS} == {
        "card": [13, 7, 11, 14, 14, 14, 13],
        "bump": [13, 11, 15, 12, 10, 10, 8],
        "wall": [13, 13, 13, 9, 9, 15, 3],
    }
    assert sum(row.successes for row in ROWS) == 240 and len(ROWS) * TRIES == 315
    assert BASELINES.keys() == DOMAINS.keys()
    soft = {key for key, spec in SPECS.items() if not spec.is_rigid}
    assert soft == {
        "card-tissue",
        "card-chocolate_chips",
        "bump-sponge",
        "bump-diaper_box",
        "wall-sponge",
        "wall-water_tissue_box",
    }
    assert all(spec.half_size == pytest.approx(DOMAINS[spec.domain].half_size) for spec in SPECS.values())
    assert all(pair.source for surface in SURFACES.values() for pair in (surface.finger, surface.table))


def test_a_surface_decides_both_of_its_pairs():
    surface = Surface("felt", Friction(0.7, "measured"), Friction(0.25, "measured"))
    domain = place_object(CARD, replace(SPECS["card-wood"], surface=surface))
    for contact in (SOFT, HARD):
        model = load_model(domain, contact=contact)
        found = {name: model.geom(name).friction[0] for name in ("table", "panda_finger1_tip", OBJECT)}
        found_with = {name: max(found[name], found[OBJECT]) for name in ("table", "panda_finger1_tip")}
        assert found_with == {"table": pytest.approx(0.25), "panda_finger1_tip": pytest.approx(0.7)}


def test_a_soft_face_gives_way_as_its_stiffness_says():
    """Pressed flat on the table by a weight of its own: both plates of an axis in a row."""
    spec = replace(SPECS["bump-sponge"], compliance=Softness(1000.0, 0.01))
    model = load_model(place_object(BUMP, spec), contact=HARD)
    data, load = mujoco.MjData(model), 4.0
    mujoco.mj_resetDataKeyframe(model, data, 0)
    data.xfrc_applied[model.body(f"{OBJECT}_upper_z").id, 2] = -load
    mujoco.mj_step(model, data, 1000)
    given_way = [abs(data.joint(f"{OBJECT}_{side}_z").qpos[0]) for side in ("upper", "lower")]
    assert sum(given_way) == pytest.approx(load / 1000.0, rel=0.1)  # and its own weight, .3 N


def test_what_gives_way_is_no_penetration():
    pose, joints = sample_task(BUMP, np.random.default_rng(0))[0], np.zeros(9)
    joints[:7] = [0, -0.8, 0, -2.4, 0, 1.6, 0.8]
    sunk = replace(pose, position=pose.position - [0, 0, 0.003])
    for name, depth in (("default", 0.003), ("sponge", 0.0)):
        found = Penetration(domain_with("bump", name)).depths(joints, sunk)
        assert found.get("object-surroundings", 0.0) == pytest.approx(depth, abs=1e-6), name


@pytest.mark.parametrize("factor", (0.8, 1.2))
@pytest.mark.parametrize("domain", DOMAINS.values(), ids=DOMAINS)
def test_starts_keep_clear_of_obstacles_whatever_the_size(domain, factor):
    size = tuple(2 * factor * half for half in domain.half_size)
    other = place_object(domain, replace(rows_of(domain.name)["default"].spec, size=size))
    model = load_model(other)
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    at = model.joint(OBJECT).qposadr[0]
    fixed = [geom for geom in range(model.ngeom) if model.geom(geom).name in {box.name for box in domain.obstacles}]
    for _ in range(50):
        for pose in sample_task(other, rng):
            data.qpos[at : at + 7] = [*pose.position, *pose.quaternion]
            mujoco.mj_kinematics(model, data)
            for geom in fixed:
                assert mujoco.mj_geomDistance(model, data, geom, model.geom(OBJECT).id, 1.0, None) > -1e-5
            assert not is_lost(other, pose.position)


@pytest.mark.parametrize("domain", DOMAINS.values(), ids=DOMAINS)
def test_scenarios_are_tasks_of_the_domain(domain):
    tasks = [make_fixed_task(domain, number) for number in range(1, COUNT + 1)]
    starts, goals = (np.array([task[i].position for task in tasks]) for i in (0, 1))
    assert np.linalg.norm(goals - starts, axis=1).min() > domain.min_distance
    for places in (starts, goals):
        assert min(np.linalg.norm(a - b) for i, a in enumerate(places) for b in places[:i]) > 0.02
    for number, (start, goal) in enumerate(tasks, start=1):
        for pose, regions in ((start, (domain.start,)), (goal, domain.goals)):
            x, y, _ = pose.position
            assert any(r.x[0] <= x <= r.x[1] and r.y[0] <= y <= r.y[1] for r in regions)
        again, same = (make_fixed_task(domain, number, np.random.default_rng(seed)) for seed in (5, 5))
        np.testing.assert_array_equal(again[0].position, same[0].position)
        assert 0 < np.abs(again[0].position - start.position).max() <= 0.002
        np.testing.assert_array_equal(again[1].position, goal.position)
    with pytest.raises(ValueError, match="scenario: expected 1 to 3, got 4"):
        make_fixed_task(domain, 4)


@every_row
def test_the_text_of_an_object_is_the_object(spec):
    assert parse_object(object_text(spec), "text") == spec


def test_the_files_of_the_guide_are_objects():
    page = Path(__file__).parents[2] / "docs/guide/your_own_object.md"
    blocks = re.findall(r"```yaml\n(.*?)```", page.read_text(), re.DOTALL)
    assert [parse_object(block, "guide").name for block in blocks] == ["tea box", "wet wipes"]


def test_a_file_names_what_it_leaves_out_by_default(tmp_path):
    path = tmp_path / "tea.yaml"
    path.write_text(TEXT)
    spec = read_object(path)
    assert spec == ObjectSpec("tea box", "card", (0.06, 0.07, 0.006), 0.012, SURFACES["paper"])
    domain = domain_with("card", str(path))
    assert domain.object == spec and domain.mass == pytest.approx(0.012) and domain.name == "card"
    assert read_domain({"domain": "card", "object": embed_object_text("card", str(path))}) == domain


CHANGES = {
    "size": ([60, 70, 6], "size: expected 0.002 to 0.3 m, got 60"),
    "mass": (12, "mass: expected 0.0005 to 2 kg, got 12"),
    "surface": (
        "glass",
        "surface: expected one of plastic, paper, vinyl, acrylic, wood, or its frictions, got 'glass'",
    ),
    "centre_of_mass": ([0, 0, 0.01], "centre_of_mass: expected a point inside the object, less than 0.003 m, got 0.01"),
    "inertia": ([1, 1, 3], "inertia: expected positive moments in kg m^2, none above the sum of the others"),
    "compliance": ({"stiffness": 1000}, "compliance: expected the key travel, got only stiffness"),
    "contents": (
        {"mass": 0.05, "clearance": [0, 0, 0], "friction": 0.3},
        "contents.mass: expected at most .9 of the object's 0.012 kg, got 0.05",
    ),
    "colour": ("red", "the file: expected no keys but name, domain, size, mass, surface, centre_of_mass"),
}


@pytest.mark.parametrize("key", CHANGES)
def test_an_error_in_a_file_says_in_one_line_what_was_expected_and_what_came(key):
    value, said = CHANGES[key]
    with pytest.raises(ObjectError) as caught:
        parse_object(yaml.safe_dump({**yaml.safe_load(TEXT), key: value}), "tea.yaml")
    assert str(caught.value).startswith(f"object tea.yaml: {said}") and "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "text, said",
    {
        "": "the file: expected the keys name, domain, size, mass, surface, got None",
        "name: x": "the file: expected the key domain, got only name",
        "size: [": "expected YAML, got",
        TEXT.replace("0.012 ", "12 g"): "mass: expected 0.0005 to 2 kg, got '12 g'",
        TEXT.replace("0.06,", ""): "size: expected three numbers in m, got",
        TEXT.replace("0.012 ", ".nan"): "mass: expected 0.0005 to 2 kg, got nan",
        TEXT.replace("0.012 ", "true"): "mass: expected 0.0005 to 2 kg, got True",
        TEXT.replace("name: tea box", "name: 3"): "name: expected a word, got 3",
    }.items(),
)
def test_what_is_no_object_is_refused(text, said):
    with pytest.raises(ObjectError) as caught:
        parse_object(text, "tea.yaml")
    assert f"object tea.yaml: {said}" in str(caught.value) and "\n" not in str(caught.value)


def test_an_object_that_is_not_there_or_of_another_domain_is_refused(tmp_path):
    with pytest.raises(ValueError, match="object: expected one of default, wrapped, .*, or a .yaml file, got 'sponge'"):
        domain_with("card", "sponge")
    with pytest.raises(ObjectError, match="expected a YAML file that can be read, got: No such file"):
        find_object("card", str(tmp_path / "none.yaml"))
    (tmp_path / "tea.yml").write_text(TEXT)
    with pytest.raises(ObjectError, match="object tea box: expected one of domain wall, got one of card"):
        find_object("wall", str(tmp_path / "tea.yml"))
    with pytest.raises(ValueError, match="domain: expected one of"):
        rows_of("table")
    assert WALL.object is None


def test_everything_of_a_spec_can_be_said_in_a_file():
    text = object_text(replace(SPECS["wall-water_tissue_box"], inertia=(1e-3, 1e-3, 1e-3)))
    assert set(yaml.safe_load(text)) == {field.name for field in fields(ObjectSpec)}
