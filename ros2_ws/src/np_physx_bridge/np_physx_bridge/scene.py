"""The scene in PhysX: a translation of the compiled MuJoCo scene, so that masses, frames, shapes and limits have one source.

What is translated: bodies with mass, centre of mass and inertia; hinges and slides with range and armature; boxes, capsules,
spheres and planes with the same collision bits. What is not: how contacts give way. PhysX's do not, but flat fingertips do, as links of
their own. What shapes stand for a geom is in `np_physx_bridge.shapes`.
"""

from __future__ import annotations

from types import ModuleType

import mujoco
import numpy as np

from np_description.contact.model import RUBBER_STIFFNESS, ContactModel
from np_description.contact.penetration import kind_of
from np_description.scene import OBJECT, TIP
from np_physx_bridge.shapes import (
    lie_on_edges,
    place_shape,
    press_with_corners,
    rotation_from_x,
    sphere_positions,
    stand_on_corners,
)

# m, from which on contacts are looked for: what comes at .25 m/s and more, .5 mm and more in a step, has to be seen a step before it touches.
CONTACT_OFFSET = 3e-3
# Objects of several bodies keep the library's own: with less, a packet in which a block slides sways a while after it was put down.
PARTS_CONTACT_OFFSET = 1e-2
# m/s, at which what is in each other comes apart at most. It is also all that can be set right of what the solver leaves undone: with .1 a
# finger of 1.1 kg is pressed through a card of 8 g from 12 N on, with 1 it is .05 mm deep at 60 N.
SURFACING = 1.0
PAD_MASS, PAD_STROKE = 5e-3, 3e-3  # kg, of 5.6 cm^3 of rubber less than of a whole finger; m, to either side
# Stiffness across the finger, of that along it. Rubber's shear modulus is a third of Young's, and its backing adds to it. With a third a pad that leans
# by 10 degrees and turns lets a card turn by 6; where it is rigid, a leaned hand hops (`np_sim_bridge.hand_bench`).
SHEAR = 0.5
# Of a pad's joints: suffix of the name, direction in the hand, share of the pad's mass. A link of 1.7 g that presses is 9 mm deep at 40 N, for one
# pass of the solver hands little through it: so the first link moves along the finger with all the mass, and most of it is in the last, which touches.
ALONG = "_along"
PAD_JOINTS = ((ALONG, (0.0, 0.0, 1.0), 0.1), ("_across", (1.0, 0.0, 0.0), 0.1), ("", (0.0, 1.0, 0.0), 0.8))
# With fewer, a box that is pulled at .9 of its friction creeps; with 100, a card turns by 20 degrees under a tip that is drawn across it.
POSITION_ITERATIONS, VELOCITY_ITERATIONS = 40, 1
# Of several bodies: with 40 a soft card of 1 g held fast under a tip that drew it 29 mm in MuJoCo, and leapt by 5 to 8 mm when it was let go.
PARTS_ITERATIONS = 120
# kg, of what one step of 2 ms bears between arm and table. All that one pass of the solver hands through a body is its mass times a speed: what is
# lighter resists a tip of 10 N that draws it slowly by less than Coulomb's friction (5 g by .87 of it, 1 g by .65, with four steps .8), is pressed
# through at 20 N (1 g: 6 mm, and it leaps), and has as many more, shorter steps. But of too many passes in 2 ms single precision makes a
# contact that comes and goes: with 576 a card of any mass slips under a tip that had drawn it along.
LIGHT, MOST_STEPS, MOST_STEPS_OF_PARTS = 1e-2, 4, 2
STICTION = 1e4  # N s/m, Nm s/rad: slope of Coulomb friction about standstill, until its limit is reached
HINGE, SLIDE = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)


def coefficient(contact: ContactModel, friction: float, is_object: bool) -> float:
    """Coulomb coefficient of one shape, such that a pair's average is what MuJoCo makes of the pair: the partner's with the
    object, the larger one between robot and surroundings (there a partner less rough than the table has its own instead). No partner
    comes below half of what the table has with the object."""
    return contact.table if is_object else max(0.0, 2 * friction - contact.table)


def count_substeps(mass: float, *, is_rigid: bool) -> int:
    """Number of engine steps in 2 ms for an object of a mass kg: one from LIGHT on."""
    # A float of .008 over another must not make 2 of 1.
    wanted = int(np.ceil(LIGHT / mass - 1e-6))
    return max(1, min(wanted, MOST_STEPS if is_rigid else MOST_STEPS_OF_PARTS))


def scene(library: ModuleType, timestep: float):
    """An empty scene with gravity and its PhysX system; timestep s."""
    physx = library.physx
    # With its cache of contact points (PCM): without it a face holds what lies beside its edges, and rods are seen too late.
    physx.set_scene_config(gravity=[0, 0, -9.81], enable_tgs=True, enable_pcm=True, enable_enhanced_determinism=True)
    system = physx.PhysxCpuSystem()
    system.set_timestep(timestep)
    return library.Scene([system]), system


class Translator:
    """Builds the parts of a scene from a compiled model whose frictions are those of `contact`.

    `kinds` gives for every shape what it is a part of (`np_description.contact.penetration.kind_of`).
    """

    def __init__(self, library: ModuleType, model: mujoco.MjModel, contact: ContactModel):
        self._sapien, self._physx = library, library.physx
        self._model, self._contact = model, contact
        self.kinds: dict[object, str] = {}

    def surroundings(self):
        """The fixed bodies as one entity."""
        component = self._physx.PhysxRigidStaticComponent()
        self._attach(component, self._geoms(0))
        entity = self._sapien.Entity()
        entity.add_component(component)
        return entity

    def free_body(self, name: str):
        """A body with a free joint: its entity and component."""
        body = self._model.body(name).id
        component = self._physx.PhysxRigidDynamicComponent()
        self._attach(component, self._geoms(body))
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
            pads = self._pads(body)
            geoms = [geom for geom in self._geoms(body) if geom not in pads]
            self._attach(link, geoms, PARTS_CONTACT_OFFSET if is_free else CONTACT_OFFSET)
            self._weigh(link, body)
            self._without(link, pads)
            if body == first:
                link.joint.type = "free" if is_free else "fixed"
            elif name := self._join(link.joint, body):
                joints[name] = link.joint
                if is_free:
                    self._spring(link.joint, name)
            links[body] = link
            for part in (link, *(part for geom in pads for part in self._pad(link, geom))):
                part.set_disable_gravity(not is_free)
                part.set_linear_damping(0.0)
                part.set_angular_damping(0.0)
                part.set_max_depenetration_velocity(SURFACING)
                entity = self._sapien.Entity()
                entity.add_component(part)
                entities.append(entity)
        articulation = links[first].articulation
        articulation.set_sleep_threshold(0.0)
        articulation.set_solver_position_iterations(PARTS_ITERATIONS if is_free else POSITION_ITERATIONS)
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
        turned = pose([0, 0, 0], rotation_from_x(model.jnt_axis[number]))
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

    def _without(self, link, pads: list[int]) -> None:
        """Take the mass of its pads off a link, and its centre of mass to where the rest has it."""
        mass, place = link.mass, link.cmass_local_pose
        rest = mass - len(pads) * PAD_MASS
        moment = mass * place.p - PAD_MASS * sum(self._model.geom_pos[geom] for geom in pads)
        link.set_mass(rest)
        link.set_cmass_local_pose(self._sapien.Pose(moment / rest, place.q))

    def _pads(self, body: int) -> list[int]:
        """The flat fingertips of a body, which are links of their own."""
        model, box = self._model, mujoco.mjtGeom.mjGEOM_BOX
        return [g for g in self._geoms(body) if model.geom(g).name.endswith(f"_{TIP}") and model.geom_type[g] == box]

    def _pad(self, finger, geom: int) -> list:
        """A flat fingertip on its finger: three links, as it gives way in three directions, with springs and dampers of rubber. The last one touches.

        PhysX's solver goes from contact to contact. On a card of 8 g between a table and an arm of 10 kg it does not converge: a hand that
        came down at .13 m/s sank 1.7 mm into it. It flew up again with .87 of its speed, and hardly touched the card. With a tip as light as
        the card, and rubber's damper, it is .56, in MuJoCo .49 (`tests/np_physx_bridge/test_physx_contacts.py`). A pad that gives way only along
        a leaned finger couples friction with pressing: a hand that draws a box then hops (`np_sim_bridge.hand_bench`).
        """
        model, rubber = self._model, self._contact.rubber
        place = self._sapien.Pose(model.geom_pos[geom], model.geom_quat[geom])
        x, y, z = model.geom_size[geom]
        damping_time = 2 * rubber.damping_ratio * rubber.time_constant
        links, link = [], finger
        for suffix, direction, share in PAD_JOINTS:
            mass = share * PAD_MASS
            link = self._physx.PhysxArticulationLinkComponent(link)
            link.set_mass(mass)
            link.set_cmass_local_pose(place)
            link.set_inertia(mass / 3 * np.array([y * y + z * z, x * x + z * z, x * x + y * y]))
            stiffness = RUBBER_STIFFNESS * (1.0 if suffix == ALONG else SHEAR)
            joint, axis = link.joint, place * self._sapien.Pose([0, 0, 0], rotation_from_x(np.array(direction)))
            joint.type = "prismatic"
            joint.pose_in_parent, joint.pose_in_child = axis, axis
            joint.set_limits([[-PAD_STROKE, PAD_STROKE]])
            joint.set_friction(0.0)
            joint.set_drive_properties(stiffness, damping_time * stiffness)
            joint.set_drive_target(0.0)
            joint.set_drive_velocity_target(0.0)
            joint.name = model.geom(geom).name + suffix
            links.append(link)
        self._attach(link, [geom])
        return links

    def _geoms(self, body: int) -> range:
        first = self._model.body_geomadr[body]
        return range(first, first + self._model.body_geomnum[body])

    def _attach(self, component, geoms, offset: float = CONTACT_OFFSET) -> None:
        """The colliding ones of some geoms, for which contacts are looked for from `offset` m on."""
        model = self._model
        for geom in geoms:
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
                shape.set_collision_groups([kind, affinity, int(is_plane), 0])
            if is_object and model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_BOX:
                of_box = (
                    self._physx,
                    shapes[0],
                    model.geom_size[geom],
                    material,
                    self._sapien.Pose,
                    model.geom_pos[geom],
                )
                shapes += lie_on_edges(*of_box) + stand_on_corners(*of_box)
            if is_tip and model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_BOX:
                shapes += press_with_corners(self._physx, shapes[0], model.geom_size[geom], material, self._sapien.Pose)
            for shape in shapes:
                shape.set_contact_offset(offset)
                shape.set_rest_offset(0.0)
                component.attach(shape)
                self.kinds[shape] = kind_of(model.geom(geom).name)

    def _shapes(self, geom: int, material) -> list:
        """The shapes of one geom, where it stands on its body."""
        model, physx, kind = self._model, self._physx, mujoco.mjtGeom(self._model.geom_type[geom])
        size, place = model.geom_size[geom], self._sapien.Pose(model.geom_pos[geom], model.geom_quat[geom])
        if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:  # along z in MuJoCo
            return [
                place_shape(physx.PhysxCollisionShapeSphere(size[0], material), place * self._sapien.Pose([0, 0, z]))
                for z in sphere_positions(size[0], size[1])
            ]
        if kind == mujoco.mjtGeom.mjGEOM_BOX:
            return [place_shape(physx.PhysxCollisionShapeBox(size, material), place)]
        if kind == mujoco.mjtGeom.mjGEOM_SPHERE:
            return [place_shape(physx.PhysxCollisionShapeSphere(size[0], material), place)]
        turned = self._sapien.Pose(
            [0, 0, 0], rotation_from_x(np.array([0.0, 0, 1]))
        )  # a plane faces x in PhysX, z in MuJoCo
        return [place_shape(physx.PhysxCollisionShapePlane(material), place * turned)]
