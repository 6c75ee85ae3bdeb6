"""The scene in PhysX: a translation of the compiled MuJoCo scene, so that masses, frames, shapes and limits have one source.

What is translated: bodies with mass, centre of mass and inertia; hinges and slides with range and armature; boxes, capsules,
spheres and planes with the same collision bits. What is not: how contacts give way. PhysX's do not. A box
of the object stands on its corners (`stand_on_corners`), a flat fingertip presses with its own (`press_with_corners`).
"""

from __future__ import annotations

from types import ModuleType

import mujoco
import numpy as np

from np_description.contact import ContactModel
from np_description.scene import OBJECT, TIP

# m, from which on contacts are looked for: what comes at .25 m/s and more, .5 mm and more in a step, has to be seen a step before it touches.
CONTACT_OFFSET = 3e-3
# Objects of several bodies keep the library's own: with less, the plates of a soft card sink into the table.
PARTS_CONTACT_OFFSET = 1e-2
# m/s, at which what is in each other comes apart at most. It is also all that can be set right of what the solver leaves undone: with .1 a
# finger of 1.1 kg is pressed through a card of 8 g from 12 N on, with 1 it is .05 mm deep at 60 N.
SURFACING = 1.0
SAGITTA = 1e-4  # m
CORNER_RADIUS, EDGE_RADIUS = 2.5e-4, 5e-4  # m
# m; proud by .42 of its radius and more, a sphere covers the box's corner, which would touch first otherwise.
TIP_CORNER_RADIUS, TIP_CORNER_PROUD = 1e-4, 4.5e-5
SURROUNDINGS_BIT = 1  # of table and obstacles, as in the compiled scene
PLANE_BIT = 1 << 10  # of what only a plane touches
POSITION_ITERATIONS, VELOCITY_ITERATIONS = 40, 1  # with fewer, a box that is pulled at .9 of its friction creeps
SIGNS = np.stack(np.meshgrid(*[(-1.0, 1.0)] * 3), -1).reshape(-1, 3).astype(np.float32)  # of a box's corners, (8, 3)
STICTION = 1e4  # N s/m, Nm s/rad: slope of Coulomb friction about standstill, until its limit is reached
HINGE, SLIDE = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)


def coefficient(contact: ContactModel, friction: float, is_object: bool) -> float:
    """Coulomb coefficient of one shape, such that a pair's average is what MuJoCo makes of the pair: the partner's with the
    object, the larger one between robot and surroundings (there a partner less rough than the table has its own instead). No partner
    comes below half of what the table has with the object."""
    return contact.table if is_object else max(0.0, 2 * friction - contact.table)


def scene(library: ModuleType, timestep: float):
    """An empty scene with gravity and its PhysX system; timestep s."""
    physx = library.physx
    # With its cache of contact points (PCM): without it a face holds what lies beside its edges, and rods are seen too late.
    physx.set_scene_config(gravity=[0, 0, -9.81], enable_tgs=True, enable_pcm=True, enable_enhanced_determinism=True)
    system = physx.PhysxCpuSystem()
    system.set_timestep(timestep)
    return library.Scene([system]), system


class Translator:
    """Builds the parts of a scene from a compiled model whose frictions are those of `contact`."""

    def __init__(self, library: ModuleType, model: mujoco.MjModel, contact: ContactModel):
        self._sapien, self._physx = library, library.physx
        self._model, self._contact = model, contact

    def surroundings(self):
        """What does not move, as one entity."""
        component = self._physx.PhysxRigidStaticComponent()
        self._attach(component, 0, CONTACT_OFFSET)
        entity = self._sapien.Entity()
        entity.add_component(component)
        return entity

    def free_body(self, name: str):
        """A body with a free joint: its entity and component."""
        body = self._model.body(name).id
        component = self._physx.PhysxRigidDynamicComponent()
        self._attach(component, body, CONTACT_OFFSET)
        self._weigh(component, body)
        component.set_linear_damping(0.0)
        component.set_angular_damping(0.0)
        component.set_max_depenetration_velocity(SURFACING)
        component.set_sleep_threshold(0.0)
        component.set_solver_position_iterations(POSITION_ITERATIONS)
        component.set_solver_velocity_iterations(VELOCITY_ITERATIONS)
        entity = self._sapien.Entity()
        entity.add_component(component)
        return entity, component

    def articulation(self, root: str, *, is_free: bool = False):
        """The tree of bodies below `root`: its entities and, by joint, components. It stands still and weighs nothing, or moves
        freely and has weight, and springs and friction of its joints act by themselves."""
        model, links, entities, joints = self._model, {}, [], {}
        first = model.body(root).id
        for body in range(first, model.nbody):  # parents come before their children
            parent = int(model.body_parentid[body])
            if body != first and parent not in links:
                continue
            link = self._physx.PhysxArticulationLinkComponent(links.get(parent))
            self._attach(link, body, PARTS_CONTACT_OFFSET if is_free else CONTACT_OFFSET)
            self._weigh(link, body)
            link.set_disable_gravity(not is_free)
            link.set_linear_damping(0.0)
            link.set_angular_damping(0.0)
            if not is_free:
                link.set_max_depenetration_velocity(SURFACING)
            if body == first:
                link.joint.type = "free" if is_free else "fixed"
            elif name := self._join(link.joint, body):
                joints[name] = link.joint
                if is_free:
                    self._spring(link.joint, name)
            entity = self._sapien.Entity()
            entity.add_component(link)
            links[body] = link
            entities.append(entity)
        articulation = links[first].articulation
        articulation.set_sleep_threshold(0.0)
        articulation.set_solver_position_iterations(POSITION_ITERATIONS)
        articulation.set_solver_velocity_iterations(VELOCITY_ITERATIONS)
        return entities, articulation, joints

    def _join(self, joint, body: int) -> str:
        """Set the joint that moves `body`; its name, empty where it is fixed."""
        model, pose = self._model, self._sapien.Pose
        frame = pose(model.body_pos[body], model.body_quat[body])
        joint.type = "fixed"
        if not model.body_jntnum[body]:
            joint.pose_in_parent = frame
            return ""
        number = int(model.body_jntadr[body])
        # A joint of PhysX moves along or about its x axis.
        turned = pose([0, 0, 0], _from_x(model.jnt_axis[number]))
        joint.pose_in_parent, joint.pose_in_child = frame * turned, turned
        joint.type = {HINGE: "revolute_unwrapped", SLIDE: "prismatic"}[int(model.jnt_type[number])]
        joint.set_limits([model.jnt_range[number]])
        joint.set_armature([model.dof_armature[model.jnt_dofadr[number]]])
        joint.set_friction(0.0)
        joint.name = model.joint(number).name
        return joint.name

    def _spring(self, joint, name: str) -> None:
        """A spring towards 0 with its damping, or friction: a drive towards standstill that gives at most so much."""
        model, number = self._model, self._model.joint(name).id
        dof = model.jnt_dofadr[number]
        stiffness, friction = float(model.jnt_stiffness[number]), float(model.dof_frictionloss[dof])
        if friction:
            joint.set_drive_properties(0.0, STICTION, friction)
        else:
            joint.set_drive_properties(stiffness, float(model.dof_damping[dof]))
        joint.set_drive_target(0.0)
        joint.set_drive_velocity_target(0.0)

    def _weigh(self, component, body: int) -> None:
        model = self._model
        component.set_mass(model.body_mass[body])
        component.set_cmass_local_pose(self._sapien.Pose(model.body_ipos[body], model.body_iquat[body]))
        component.set_inertia(model.body_inertia[body])

    def _attach(self, component, body: int, offset: float) -> None:
        """The colliding shapes of a body, for which contacts are looked for from `offset` m on."""
        model = self._model
        for geom in range(model.body_geomadr[body], model.body_geomadr[body] + model.body_geomnum[body]):
            kind, affinity = int(model.geom_contype[geom]), int(model.geom_conaffinity[geom])
            if not (kind or affinity):
                continue
            is_object = model.geom(geom).name.startswith(OBJECT)
            friction = coefficient(self._contact, float(model.geom_friction[geom, 0]), is_object=is_object)
            is_plane = model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_PLANE
            is_tip = model.geom(geom).name.endswith(f"_{TIP}")
            material = self._physx.PhysxMaterial(friction, friction, 0.0)
            shapes = self._shapes(geom, material)
            for shape in shapes:
                shape.set_collision_groups([kind | (PLANE_BIT if is_plane else 0), affinity, int(is_plane), 0])
            if is_object and model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_BOX:
                shapes += lie_on_edges(self._physx, shapes[0], model.geom_size[geom], material, self._sapien.Pose)
                shapes += stand_on_corners(self._physx, shapes[0], model.geom_size[geom], material, self._sapien.Pose)
            if is_tip and model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_BOX:
                shapes += press_with_corners(self._physx, shapes[0], model.geom_size[geom], material, self._sapien.Pose)
            for shape in shapes:
                shape.set_contact_offset(offset)
                shape.set_rest_offset(0.0)
                component.attach(shape)

    def _shapes(self, geom: int, material) -> list:
        """The shapes of one geom, where it stands on its body."""
        model, physx, kind = self._model, self._physx, mujoco.mjtGeom(self._model.geom_type[geom])
        size, place = model.geom_size[geom], self._sapien.Pose(model.geom_pos[geom], model.geom_quat[geom])
        if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:  # along z in MuJoCo
            return [
                _placed(physx.PhysxCollisionShapeSphere(size[0], material), place * self._sapien.Pose([0, 0, z]))
                for z in along(size[0], size[1])
            ]
        if kind == mujoco.mjtGeom.mjGEOM_BOX:
            return [_placed(physx.PhysxCollisionShapeBox(size, material), place)]
        if kind == mujoco.mjtGeom.mjGEOM_SPHERE:
            return [_placed(physx.PhysxCollisionShapeSphere(size[0], material), place)]
        turned = self._sapien.Pose([0, 0, 0], _from_x(np.array([0.0, 0, 1])))  # a plane faces x in PhysX, z in MuJoCo
        return [_placed(physx.PhysxCollisionShapePlane(material), place * turned)]


def stand_on_corners(physx: ModuleType, box, half_size, material, pose) -> list:
    """Spheres in the corners of a box, which from then on touch planes in its place; all else touches the box.

    A face of a box on a plane is one patch, whose friction PhysX takes to be the same everywhere in it, wherever it is pressed. A card
    that a fingertip presses beside its middle and draws is then turned about the tip, by 44 degrees over 60 mm, where the law of Coulomb
    turns it not at all: friction has its centre where the load has. Each sphere has friction of its own, by its own load
    (`np_sim_bridge.static_bench.drag_off_centre`). half_size (3,) m; pose: the library's Pose.
    """
    groups = box.get_collision_groups()
    box.set_collision_groups([groups[0], groups[1], groups[2] | 1, groups[3]])  # of those that pass planes by
    corners = _corners(physx, box, half_size, material, pose, CORNER_RADIUS)
    for corner in corners:
        corner.set_collision_groups([0, PLANE_BIT, 0, 0])
    return corners


def press_with_corners(physx: ModuleType, box, half_size, material, pose) -> list:
    """Spheres in the corners of a flat fingertip, proud of it, so that on a face they touch in its place; what meets it within its own faces
    touches the box.

    PhysX holds a patch by two of its points, with half of its load each, and counts to it what is within the contact offset: leaned by 3 to 10
    degrees, a pad turned a card by an edge that was in the air, by 22 degrees where it slips by the law of Coulomb. Each sphere has friction of
    its own, by its own load (`tests/unit/test_physx.py`). half_size (3,) m; pose: the library's Pose.
    """
    corners = _corners(physx, box, half_size, material, pose, TIP_CORNER_RADIUS, TIP_CORNER_PROUD)
    for corner in corners:
        corner.set_collision_groups(box.get_collision_groups())
    return corners


def _corners(physx: ModuleType, box, half_size, material, pose, radius: float, proud: float = 0.0) -> list:
    """Spheres in the corners of a box, `proud` m of its faces."""
    place, inner = box.get_local_pose(), np.asarray(half_size) - radius + proud
    return [_placed(physx.PhysxCollisionShapeSphere(radius, material), place * pose(s * inner)) for s in SIGNS]


def lie_on_edges(physx: ModuleType, box, half_size, material, pose) -> list:
    """Rods along the edges of a box, which touch the boxes of the surroundings before the edges do.

    Where edges of two boxes cross, PhysX takes the normal of a face: it pushes aside, and lets the one fall through the other, a cube up to
    21 mm deep into the bump. Of a rod and a box it finds the true one. half_size (3,) m; pose: the library's Pose.
    """
    half, place = np.asarray(half_size), box.get_local_pose()
    rods = []
    for axis in range(3):
        for signs in SIGNS[SIGNS[:, axis] > 0]:
            middle = signs * (half - EDGE_RADIUS)
            middle[axis] = 0.0
            rod = physx.PhysxCollisionShapeCapsule(EDGE_RADIUS, half[axis] - EDGE_RADIUS, material)
            rod.set_local_pose(place * pose(middle, _from_x(np.eye(3)[axis])))
            rod.set_collision_groups([0, SURROUNDINGS_BIT, 1, 0])
            rods.append(rod)
    return rods


def along(radius: float, half_length: float) -> np.ndarray:
    """Places (n,) m, along its axis, of the spheres that a capsule is made of: between two of them it is SAGITTA thinner.

    PhysX's own capsule is not: beside an edge of a box it was seen too late, 6 mm deep and more in one approach of 20, and was
    then thrown out (docs/decisions/policies.md).
    """
    apart = 2 * np.sqrt(radius**2 - (radius - SAGITTA) ** 2)
    return np.linspace(-half_length, half_length, 1 + int(np.ceil(2 * half_length / apart)))


def _placed(shape, pose):
    shape.set_local_pose(pose)
    return shape


def _from_x(axis: np.ndarray) -> np.ndarray:
    """Quaternion wxyz (4,) of a rotation that takes x to x, y or z."""
    half = np.sqrt(0.5)
    if np.allclose(axis, [1, 0, 0]):
        return np.array([1.0, 0, 0, 0])
    if np.allclose(axis, [0, 0, 1]):
        return np.array([half, 0, -half, 0])
    if np.allclose(axis, [0, 1, 0]):
        return np.array([half, 0, 0, half])
    raise ValueError(f"joint axis: expected x, y or z, got {axis}")
