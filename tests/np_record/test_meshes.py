"""How the arm looks is nobody's business but the eye's: with meshes everything that is simulated is what it was."""

import mujoco
import numpy as np
import pytest

from np_common.rotations import matrix_from_quaternion
from np_description.domains import BUMP, CARD, Pose
from np_description.drawing import meshes
from np_description.drawing.robot import urdf, visual_shapes
from np_description.drawing.scene_data import SceneData
from np_description.panda import FINGER_MAX, NOMINAL
from np_description.scene import build_scene, load_model
from np_record.report.third_person import ThirdPerson

FILES = sorted(set(meshes._FILES.values()))
READY = np.append(NOMINAL.ready, [0.02, 0.02])
CORNERS = 0.05 * np.array([(1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1)])  # m, of a tetrahedron
OUTWARDS = ((0, 1, 2), (0, 2, 3), (0, 3, 1), (1, 3, 2))

SIMULATED = (
    "qpos",
    "body_",
    "jnt_",
    "dof_",
    "actuator_",
    "site_",
    "eq_",
    "pair_",
    "exclude_",
    "tendon_",
    "key_",
    "sensor_",
)
"""How fields of a compiled model begin that say what is simulated; geoms are compared one by one."""
APART = ("body_geomnum", "body_geomadr", "body_bvhadr", "body_bvhnum", "dof_length")
"""Of these: where the geoms of a body stand in the list of all, and the length by which MuJoCo would judge who sleeps."""


def stl(corners) -> bytes:
    """A tetrahedron as a binary STL file."""
    written = np.zeros(len(OUTWARDS), meshes._STL)
    written["corners"] = [[corners[k] for k in triangle] for triangle in OUTWARDS]
    return bytes(80) + np.uint32(len(OUTWARDS)).tobytes() + written.tobytes()


@pytest.fixture
def tetrahedra(tmp_path):
    """A mesh of each body, from files that begin at places of their own."""
    for number, file in enumerate(FILES):
        (tmp_path / file).write_bytes(stl(CORNERS + 0.01 * number))
    return meshes.read_meshes(tmp_path, lambda mesh: mesh)


@pytest.fixture(params=["tetrahedra", "installed"])
def looks(request):
    """Meshes that are made here, and Franka's where they are installed."""
    if request.param == "installed":
        if not meshes.has_meshes():
            pytest.skip("make meshes")
        return meshes.arm_meshes(meshes.CANVAS)
    return request.getfixturevalue("tetrahedra")


def dressed(domain, looks) -> mujoco.MjModel:
    spec = build_scene(domain)
    meshes.attach_meshes(spec, looks)
    return spec.compile()


@pytest.mark.parametrize("domain", [CARD, BUMP], ids=lambda domain: domain.name)
def test_what_is_simulated_is_equal_bit_for_bit(looks, domain):
    plain, other = load_model(domain), dressed(domain, looks)
    names = [name for name in dir(plain) if name.startswith(SIMULATED) and name not in APART]
    compared = [name for name in names if isinstance(getattr(plain, name), np.ndarray)]
    assert len(compared) > 100
    for name in compared:
        np.testing.assert_array_equal(getattr(other, name), getattr(plain, name), name)
    for name in ("timestep", "cone", "impratio", "integrator", "iterations", "gravity"):
        np.testing.assert_array_equal(getattr(other.opt, name), getattr(plain.opt, name), name)
    touching = [[i for i in range(m.ngeom) if m.geom_contype[i] | m.geom_conaffinity[i]] for m in (plain, other)]
    assert len(touching[0]) == len(touching[1]) > 10
    for name in dir(plain):
        if name.startswith("geom_") and name not in ("geom_dataid", "geom_group", "geom_bodyid"):
            mine, its = (getattr(m, name)[kept] for m, kept in zip((plain, other), touching))
            np.testing.assert_array_equal(its, mine, name)


def test_motion_is_equal_bit_for_bit(looks):
    """Two seconds of torques that throw the arm about, onto table and object."""
    ran = []
    for model in (load_model(BUMP), dressed(BUMP, looks)):
        data, generator = mujoco.MjData(model), np.random.default_rng(1)
        mujoco.mj_resetDataKeyframe(model, data, 0)
        touched = 0
        for step in range(1000):
            if step % 50 == 0:
                data.ctrl[:7] = generator.uniform(-0.4, 0.4, 7) * NOMINAL.torque_limit
            mujoco.mj_step(model, data)
            touched = max(touched, data.ncon)
        assert touched >= 4
        ran.append((data.qpos.copy(), data.qvel.copy(), touched))
    for mine, its in zip(*ran):
        np.testing.assert_array_equal(its, mine)


def test_a_mesh_stands_where_its_file_has_it(tetrahedra):
    """MuJoCo moves a mesh into axes of its own: the shape that is drawn has it back."""
    model = dressed(CARD, tetrahedra)
    drawn = [shape for shape in visual_shapes(model) if shape.kind == "mesh"]
    assert [shape.body for shape in drawn] == list(tetrahedra)
    assert not [s for s in visual_shapes(model) if s.body.startswith("panda") and s.kind != "mesh"]
    for shape in drawn:
        turn = np.empty(9)
        mujoco.mju_quat2Mat(turn, shape.quaternion)
        corners = shape.position + shape.vertices @ turn.reshape(3, 3).T
        number = FILES.index(meshes._FILES[shape.body])
        np.testing.assert_allclose(sorted(corners.tolist()), sorted((CORNERS + 0.01 * number).tolist()), atol=1e-6)
        a, b, c = corners[shape.triangles].transpose(1, 0, 2)
        outwards = np.einsum("ij,ij->i", np.cross(b - a, c - a), (a + b + c) / 3 - corners.mean(axis=0))
        assert (outwards > 0).all()


def bounds(data: SceneData, names) -> np.ndarray:
    """Lowest and highest corner (2, 3) m of some bodies as they are drawn, with the arm ready."""
    poses, points = data.poses(READY, None, None), []
    signs = np.array(np.meshgrid(*[(-1, 1)] * 3)).reshape(3, -1).T
    for shape in data.scene()["shapes"]:
        if data.bodies[shape["body"]] in names:
            size = np.array(shape["size"])
            half = np.array([size[0], size[0], size.sum()]) if shape["kind"] == "capsule" else size
            corners = shape["vertices"] if shape["kind"] == "mesh" else signs * half
            for pose in (np.array(shape["pose"]), np.array(poses[shape["body"]])):
                corners = pose[:3] + corners @ matrix_from_quaternion(pose[3:]).T
            points.append(corners)
    return np.stack([np.concatenate(points).min(axis=0), np.concatenate(points).max(axis=0)])


@pytest.mark.skipif(not meshes.has_meshes(), reason="make meshes")
def test_the_meshes_of_the_arm_are_where_the_shapes_that_collide_are():
    """The right files in the right frames, in metres."""
    plain, other = SceneData(CARD, meshes=False), SceneData(CARD, meshes=True)
    for names, limit in ((list(meshes._FILES), 0.06), (["panda_finger1"], 0.015), (["panda_finger2"], 0.015)):
        assert np.abs(bounds(plain, names) - bounds(other, names)).max() < limit, names
    count = sum(len(shape["triangles"]) for shape in other.scene()["shapes"] if shape["kind"] == "mesh")
    assert 4000 < count < 12000


def test_without_the_package_shapes_are_drawn_and_who_asks_for_meshes_is_told(monkeypatch):
    monkeypatch.setattr(meshes, "has_meshes", lambda: False)
    kinds = {shape["kind"] for shape in SceneData(CARD).scene()["shapes"]}
    assert kinds == {"box", "capsule", "plane"}
    with pytest.raises(meshes.NoMeshes, match="make meshes"):
        meshes.arm_meshes.__wrapped__(meshes.ALL)


def test_where_they_are_installed_they_are_drawn_unless_shapes_are_asked_for(tetrahedra, monkeypatch):
    monkeypatch.setattr(meshes, "has_meshes", lambda: True)
    monkeypatch.setattr(meshes, "arm_meshes", lambda share: tetrahedra)
    data = SceneData(CARD)
    drawn = [shape for shape in data.scene()["shapes"] if shape["kind"] == "mesh"]
    assert [data.bodies[shape["body"]] for shape in drawn] == list(tetrahedra)
    assert all(len(shape["vertices"]) == 4 == len(shape["triangles"]) for shape in drawn)
    assert {shape["kind"] for shape in SceneData(CARD, meshes=False).scene()["shapes"]} == {"box", "capsule", "plane"}
    assert "mesh" not in urdf()
    goal = Pose(np.array([0.5, 0.1, 0.0025]), np.array([1.0, 0, 0, 0]))
    pictures = [ThirdPerson(CARD, 300).picture(READY, goal, goal)]
    monkeypatch.setattr(meshes, "has_meshes", lambda: False)
    pictures.append(ThirdPerson(CARD, 300).picture(READY, goal, goal))
    bright = [int((picture.min(axis=2) > 100).sum()) for picture in pictures]
    assert 500 < bright[0] and 500 < bright[1] and not np.array_equal(*pictures)
    assert FINGER_MAX > READY[-1]
