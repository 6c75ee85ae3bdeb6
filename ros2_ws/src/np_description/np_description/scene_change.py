"""A difference between the true scene and the nominal one: table height, frictions, the object's mass. One for every engine."""

from __future__ import annotations

from dataclasses import dataclass, replace

from np_description.contact.model import ContactModel
from np_description.domains import Pose, Task


@dataclass(frozen=True)
class SceneChange:
    """A change of the nominal scene."""

    lift: float = 0.0
    """Height by which table, obstacles and what lies on them are raised, m."""
    table: float = 1.0
    """Factor of the object's friction with table and obstacles."""
    finger: float = 1.0
    """Factor of the object's friction with a fingertip."""
    mass: float = 1.0
    """Factor of the object's mass and inertia."""

    def domain(self, domain: Task) -> Task:
        """The domain with the object's true mass."""
        if self.mass == 1.0:
            return domain
        spec = domain.object
        if spec is not None:
            inertia = None if spec.inertia is None else tuple(self.mass * moment for moment in spec.inertia)
            spec = replace(spec, mass=self.mass * spec.mass, inertia=inertia)
        return replace(domain, density=self.mass * domain.density, object=spec)

    def contact(self, contact: ContactModel) -> ContactModel:
        """The contact definition with the true coefficients."""
        return replace(contact, table=self.table * contact.table, finger=self.finger * contact.finger)

    def pose(self, pose: Pose) -> Pose:
        """The true pose of something that nominally lies on the table at a pose."""
        return Pose(pose.position + [0.0, 0.0, self.lift], pose.quaternion)


UNCHANGED = SceneChange()
