"""Franka's visual meshes in place of the collision shapes, where `make meshes` has installed them.

Only for who draws: what is simulated, planned with and trained on has the shapes of `np_description.scene` and nothing else.
The meshes are those of the package gymnasium-robotics (MIT; its arm is from vikashplus/franka, Apache-2.0), of which nothing
but the files is used. They have 140,000 triangles; `CANVAS` of them are kept where a painter draws, all for OpenGL.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from types import MappingProxyType

import mujoco
import numpy as np

from np_description.domains import Task
from np_description.scene import build_scene

CANVAS, ALL = 0.06, 1.0  # shares of the triangles of the files
HIDDEN = 3  # geom group that is not drawn
_PACKAGE = "gymnasium_robotics"
_FOLDER = "envs/assets/kitchen_franka/franka_assets/meshes/visual"
_FILES = MappingProxyType(
    {f"panda_link{i}": f"link{i}.stl" for i in range(8)}
    | {"panda_hand": "hand.stl", "panda_finger1": "finger.stl", "panda_finger2": "finger.stl"}
)
_WHITE, _GREY = (0.92, 0.92, 0.92, 1.0), (0.55, 0.56, 0.58, 1.0)
_STL = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("colour", "<u2")])
_STL_HEADER = 84  # bytes

Mesh = tuple[np.ndarray, np.ndarray]
"""Vertices (n, 3) m in the frame of a body, and triangles (m, 3) of their numbers."""


class NoMeshes(ValueError):
    """The meshes are requested, and not installed."""


def has_meshes() -> bool:
    """Whether `make meshes` has been here."""
    return _folder() is not None and importlib.util.find_spec("fast_simplification") is not None


def load_visual_model(domain: Task, *, meshes: bool | None = None, share: float = ALL, **options) -> mujoco.MjModel:
    """The compiled scene of a domain for who draws it; options as for `build_scene`.

    meshes: whether the robot looks like itself or like the shapes that collide; None: like itself where the meshes are
    installed. share: of the triangles of their files that is drawn. Bodies, joints and generalised positions are those of
    `build_scene`. Raises NoMeshes.
    """
    spec = build_scene(domain, **options)
    if has_meshes() if meshes is None else meshes:
        attach_meshes(spec, arm_meshes(share))
    return spec.compile()


def attach_meshes(spec: mujoco.MjSpec, meshes: Mapping[str, Mesh]) -> None:
    """Give bodies of a scene their meshes (by name), which touch nothing and weigh nothing; their other shapes are not drawn."""
    for name, (vertices, triangles) in meshes.items():
        body = spec.body(name)
        for geom in body.geoms:
            geom.group = HIDDEN
        mesh = spec.add_mesh(name=name, uservert=vertices.ravel(), userface=triangles.ravel())
        mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL  # a visual mesh need not be closed
        body.add_geom(
            type=mujoco.mjtGeom.mjGEOM_MESH,
            meshname=name,
            rgba=_GREY if "finger" in name else _WHITE,
            group=1,
            mass=0,
            contype=0,
            conaffinity=0,
        )


@cache
def arm_meshes(share: float) -> Mapping[str, Mesh]:
    """The mesh of each body of the robot, with about such a share of the triangles of its file. Raises NoMeshes, OSError."""
    if not has_meshes():
        raise NoMeshes("meshes of the arm: expected them to be installed, they are not: run `make meshes`")
    from fast_simplification import simplify

    return read_meshes(_folder(), lambda mesh: simplify(*mesh, 1.0 - share) if share < 1.0 else mesh)


def read_meshes(folder: Path, simplify: Callable[[Mesh], Mesh]) -> Mapping[str, Mesh]:
    """The mesh of each body from the STL files of a folder. Raises OSError."""
    read = cache(lambda file: simplify(read_stl((folder / file).read_bytes())))
    return MappingProxyType({body: read(file) for body, file in _FILES.items()})


def read_stl(data: bytes) -> Mesh:
    """The triangles of a binary STL file, corners at one place being one vertex."""
    corners = np.frombuffer(data, _STL, offset=_STL_HEADER)["corners"].reshape(-1, 3)
    vertices, numbers = np.unique(corners, axis=0, return_inverse=True)
    return vertices, numbers.reshape(-1, 3).astype(np.int32)


def _folder() -> Path | None:
    """Folder of the files; the package itself would start a simulator and is not imported."""
    found = importlib.util.find_spec(_PACKAGE)
    folder = Path(found.origin).parent / _FOLDER if found and found.origin else None
    return folder if folder and folder.is_dir() else None
