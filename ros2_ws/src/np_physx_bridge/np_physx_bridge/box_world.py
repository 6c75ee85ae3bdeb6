"""The box on a table and the finger of the static bench, in PhysX."""

from __future__ import annotations

import numpy as np

from np_common.rotations import matrix_from_quaternion
from np_description.contact.model import OBJECT_FRICTION, ContactModel
from np_description.domains import Pose
from np_physx_bridge.library import sapien
from np_physx_bridge.scene import (
    CONTACT_OFFSET,
    POSITION_ITERATIONS,
    SURFACING,
    VELOCITY_ITERATIONS,
    coefficient,
    scene,
)
from np_physx_bridge.shapes import SURROUNDINGS_BIT, lie_on_edges, stand_on_corners
from np_sim_bridge.box_world import GRAVITY, STEP, TIP_RADIUS, WALL_HALF_SIZE, BoxOnTable, wall_position

TABLE, BOX, FINGER = SURROUNDINGS_BIT, 2, 4  # collision bits: the finger touches the box only
FINGER_MASS = 1.1  # kg, with the arm behind it
STIFFNESS, DAMPING, PRESSING_DAMPING = 1e5, 6e2, 50.0  # N/m, N s/m, as the finger of the other engine is led


class PhysxBoxWorld:
    """A BoxWorld of PhysX with the coefficients of friction of `contact`."""

    def __init__(self, world: BoxOnTable, contact: ContactModel, timestep: float = STEP):
        library = sapien()
        self._sapien, self._physx, self._timestep = library, library.physx, timestep
        self._pressing = world.pressing
        self._scene, self._system = scene(library, timestep)
        table = self._physx.PhysxRigidStaticComponent()
        self._attach(table, self._physx.PhysxCollisionShapePlane, (), contact, contact.table, TABLE, BOX)
        upwards = library.Pose([0, 0, 0], [np.sqrt(0.5), 0, -np.sqrt(0.5), 0])  # a plane of PhysX faces x
        self._add(table, upwards)
        if world.beside_wall:
            wall = self._physx.PhysxRigidStaticComponent()
            shape, size = self._physx.PhysxCollisionShapeBox, (list(WALL_HALF_SIZE),)
            self._attach(wall, shape, size, contact, contact.table, TABLE, BOX)
            self._add(wall, library.Pose(wall_position(world)))
        self._box = self._physx.PhysxRigidDynamicComponent()
        half = list(world.half_size)
        self._attach(
            self._box, self._physx.PhysxCollisionShapeBox, (half,), contact, OBJECT_FRICTION, BOX, TABLE | FINGER, True
        )
        x, y, z = world.half_size
        inertia = world.mass / 3 * np.array([y * y + z * z, x * x + z * z, x * x + y * y])
        self._make_body(self._box, world.mass, inertia)
        self._add(self._box, library.Pose([0, 0, z]))
        self._gravity = np.array([0.0, 0.0, -GRAVITY])
        self._force, self._height, self._press = np.zeros(3), 0.0, 0.0
        self._mass = world.mass
        self._drive = None
        if world.tip is not None:
            self._add_finger(np.asarray(world.tip), contact)

    def _attach(self, component, make, size, contact, friction, kind, affinity, is_object=False) -> None:
        own = coefficient(contact, friction, is_object)
        material = self._physx.PhysxMaterial(own, own, 0.0)
        shapes = [make(*size, material)]
        is_plane = make is self._physx.PhysxCollisionShapePlane
        shapes[0].set_collision_groups([kind, affinity, int(is_plane), 0])
        if is_object:
            of_box = self._physx, shapes[0], size[0], material, self._sapien.Pose
            shapes += lie_on_edges(*of_box) + stand_on_corners(*of_box)
        for shape in shapes:
            shape.set_contact_offset(CONTACT_OFFSET)
            shape.set_rest_offset(0.0)
            component.attach(shape)

    def _make_body(self, body, mass: float, inertia: np.ndarray) -> None:
        body.set_mass(mass)
        body.set_inertia(inertia)
        body.set_disable_gravity(True)  # gravity is a force here, so that it can be tilted
        body.set_linear_damping(0.0)
        body.set_angular_damping(0.0)
        body.set_max_depenetration_velocity(SURFACING)
        body.set_sleep_threshold(0.0)
        body.set_solver_position_iterations(POSITION_ITERATIONS)
        body.set_solver_velocity_iterations(VELOCITY_ITERATIONS)

    def _add(self, component, pose) -> None:
        entity = self._sapien.Entity()
        entity.add_component(component)
        entity.pose = pose
        self._scene.add_entity(entity)

    def _add_finger(self, tip: np.ndarray, contact: ContactModel) -> None:
        finger = self._finger = self._physx.PhysxRigidDynamicComponent()
        self._attach(finger, self._physx.PhysxCollisionShapeSphere, (TIP_RADIUS,), contact, contact.finger, FINGER, BOX)
        self._make_body(finger, FINGER_MASS, np.full(3, 1e-3))
        finger.set_locked_motion_axes([False, False, False, True, True, True])
        drive = self._drive = self._physx.PhysxDriveComponent(finger)
        drive.set_parent(None)
        by_axis = (drive.set_drive_property_x, drive.set_drive_property_y, drive.set_drive_property_z)
        for axis, set_property in enumerate(by_axis):
            is_pressing = self._pressing and self._pressing[0] == axis
            set_property(*((0.0, PRESSING_DAMPING) if is_pressing else (STIFFNESS, DAMPING)))
        entity = self._sapien.Entity()
        entity.add_component(finger)
        entity.add_component(drive)
        entity.pose = self._sapien.Pose(tip)
        self._scene.add_entity(entity)
        self.lead(tip)

    def tilt(self, angle: float, heading: float) -> None:
        """As in BoxWorld."""
        downhill = np.sin(angle) * np.array([np.cos(heading), np.sin(heading)])
        self._gravity = GRAVITY * np.array([*downhill, -np.cos(angle)])

    def pull(self, force: np.ndarray, height: float = 0.0) -> None:
        """As in BoxWorld."""
        self._force, self._height = np.asarray(force, float), height

    def lead(self, position: np.ndarray, press: float = 0.0) -> None:
        """As in BoxWorld."""
        self._drive.set_drive_target(self._sapien.Pose(np.asarray(position, float)))
        self._press = press if self._pressing else 0.0

    def step(self, seconds: float) -> None:
        """As in BoxWorld."""
        for _ in range(round(seconds / self._timestep)):
            lever = matrix_from_quaternion(self.pose().quaternion) @ [0.0, 0.0, self._height]
            self._box.add_force_torque(self._force + self._mass * self._gravity, np.cross(lever, self._force))
            if self._press:
                axis, sign = self._pressing
                self._finger.add_force_torque(sign * self._press * np.eye(3)[axis], np.zeros(3))
            self._scene.step()

    def pose(self) -> Pose:
        """As in BoxWorld."""
        pose = self._box.entity.pose
        return Pose(np.asarray(pose.p, float), np.asarray(pose.q, float))

    def velocity(self) -> np.ndarray:
        """As in BoxWorld."""
        return np.asarray(self._box.linear_velocity, float)

    def tip(self) -> np.ndarray:
        """As in BoxWorld."""
        return np.asarray(self._finger.entity.pose.p, float)
