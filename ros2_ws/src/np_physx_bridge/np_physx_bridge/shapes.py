"""PhysX shapes for a geom of MuJoCo, with the contact of rigid bodies."""

from __future__ import annotations

from types import ModuleType

import numpy as np

SAGITTA = 1e-4  # m
CORNER_RADIUS, EDGE_RADIUS = 2.5e-4, 5e-4  # m
# Rods along one edge, each with friction by its own load; m, by which rods are below the faces, so that corners carry where they can; m, by
# which what is left of the box for an obstacle's corner is smaller.
RODS, RECESS, CORE = 6, 2e-5, 5e-4
# m; proud by .42 of its radius and more, a sphere covers the box's corner, which would touch first otherwise.
TIP_CORNER_RADIUS, TIP_CORNER_PROUD = 1e-4, 4.5e-5
SURROUNDINGS_BIT = 1  # of table and obstacles, as in the compiled scene
ALL_ROUND = np.zeros(3)
SIGNS = np.stack(np.meshgrid(*[(-1.0, 1.0)] * 3), -1).reshape(-1, 3).astype(np.float32)  # of a box's corners, (8, 3)


def stand_on_corners(physx: ModuleType, box, half_size, material, pose, outward=ALL_ROUND) -> list:
    """Spheres in the corners of a box, which from then on touch table and obstacles in its place; all else touches the box.

    A face of a box on another is one patch, whose friction PhysX takes to be the same everywhere in it, wherever it is pressed. A card
    that a fingertip presses beside its middle and draws is then turned about the tip, by 44 degrees over 60 mm, where the law of Coulomb
    turns it not at all: friction has its centre where the load has. Each sphere has friction of its own, by its own load
    (`np_sim_bridge.static_bench.drag_off_centre`). half_size (3,) m; pose: the library's Pose; outward (3,): as for `lie_on_edges`.
    """
    groups = box.get_collision_groups()
    box.set_collision_groups([0, groups[1] & ~SURROUNDINGS_BIT, groups[2], groups[3]])
    corners = _corners(physx, box, half_size, material, pose, CORNER_RADIUS, signs=SIGNS[_outside(SIGNS, outward)])
    for corner in corners:
        corner.set_collision_groups([0, SURROUNDINGS_BIT, 0, 0])
    return corners


def press_with_corners(physx: ModuleType, box, half_size, material, pose) -> list:
    """Spheres in the corners of a flat fingertip, proud of it, so that on a face they touch in its place; what meets it within its own faces
    touches the box.

    PhysX holds a patch by two of its points, with half of its load each, and counts to it what is within the contact offset: leaned by 3 to 10
    degrees, a pad turned a card by an edge that was in the air, by 22 degrees where it slips by the law of Coulomb. Each sphere has friction of
    its own, by its own load (`tests/np_physx_bridge/test_physx_contacts.py`). half_size (3,) m; pose: the library's Pose.
    """
    corners = _corners(physx, box, half_size, material, pose, TIP_CORNER_RADIUS, TIP_CORNER_PROUD)
    for corner in corners:
        corner.set_collision_groups(box.get_collision_groups())
    return corners


def _corners(physx: ModuleType, box, half_size, material, pose, radius: float, proud=0.0, signs=SIGNS) -> list:
    """Spheres in the corners of a box, `proud` m of its faces."""
    place, inner = box.get_local_pose(), np.asarray(half_size) - radius + proud
    return [place_shape(physx.PhysxCollisionShapeSphere(radius, material), place * pose(s * inner)) for s in signs]


def _outside(places: np.ndarray, outward) -> np.ndarray:
    """Which (n,) of some places (n, 3) on a box are on the face to which `outward` points; all, if it points nowhere."""
    return places @ outward > 0 if np.any(outward) else np.full(len(places), True)


def lie_on_edges(physx: ModuleType, box, half_size, material, pose, outward=ALL_ROUND) -> list:
    """Rods along the edges of a box, which touch the boxes of the surroundings in its place, and what is left of it for their corners.

    Where edges of two boxes cross, PhysX takes the normal of a face: it pushes aside, and lets the one fall through the other, a cube up to
    21 mm deep into the bump. Of a rod and a box it finds the true one. Friction of a rod that is pressed at one end acts at both, as that of
    a face does: where a pressed cube hangs over the bump it turned three times as far as it should. So each edge has several, end to end.
    half_size (3,) m; pose: the library's Pose; outward (3,): from the middle of the object to a box that is only a face of it, whose other
    edges are inside.
    """
    half, place = np.asarray(half_size), box.get_local_pose()
    rods = []
    for axis in range(3):
        # None is shorter than four radii, where the edge is not.
        count = max(1, min(RODS, int(half[axis] / (2 * EDGE_RADIUS))))
        length = half[axis] / count  # of half a rod
        middles = SIGNS[SIGNS[:, axis] > 0] * (half - EDGE_RADIUS - RECESS)
        middles[:, axis] = 0.0
        for middle in middles[_outside(middles, outward)]:
            for along_it in np.linspace(length - half[axis], half[axis] - length, count):
                middle[axis] = along_it
                rod = physx.PhysxCollisionShapeCapsule(EDGE_RADIUS, max(length - EDGE_RADIUS, 1e-5), material)
                rods.append(place_shape(rod, place * pose(middle, rotation_from_x(np.eye(3)[axis]))))
    core = place_shape(physx.PhysxCollisionShapeBox(np.maximum(half - CORE, 0.5 * half), material), place)
    for shape in (*rods, core):
        shape.set_collision_groups([0, SURROUNDINGS_BIT, 1, 0])
    return [*rods, core]


def sphere_positions(radius: float, half_length: float) -> np.ndarray:
    """Places (n,) m, along its axis, of the spheres that a capsule is made of: between two of them it is SAGITTA thinner.

    PhysX's own capsule is not: beside an edge of a box it was seen too late, 6 mm deep and more in one approach of 20, and was
    then thrown out.
    """
    apart = 2 * np.sqrt(radius**2 - (radius - SAGITTA) ** 2)
    return np.linspace(-half_length, half_length, 1 + int(np.ceil(2 * half_length / apart)))


def place_shape(shape, pose):
    """The shape, at a pose in the frame of its body."""
    shape.set_local_pose(pose)
    return shape


def rotation_from_x(axis: np.ndarray) -> np.ndarray:
    """Quaternion wxyz (4,) of a rotation that takes x to x, y or z."""
    half = np.sqrt(0.5)
    if np.allclose(axis, [1, 0, 0]):
        return np.array([1.0, 0, 0, 0])
    if np.allclose(axis, [0, 0, 1]):
        return np.array([half, 0, -half, 0])
    if np.allclose(axis, [0, 1, 0]):
        return np.array([half, 0, 0, half])
    raise ValueError(f"joint axis: expected x, y or z, got {axis}")
