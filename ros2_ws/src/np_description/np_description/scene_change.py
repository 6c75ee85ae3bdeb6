"""What of a scene is other than it is believed to be: the table's height, frictions, the object's mass. One change for every engine."""

from __future__ import annotations

from dataclasses import dataclass, replace

from np_description.contact.model import ContactModel
from np_description.domains import Domain, Pose


@dataclass(frozen=True)
class SceneChange:
    """lift: m by which table, obstacles and what lies on them are higher. table, finger: factors of the coefficient of friction of the
    object with table and obstacles, and with a fingertip. mass: factor of the object's mass, with its inertia."""

    lift: float = 0.0
    table: float = 1.0
    finger: float = 1.0
    mass: float = 1.0

    def domain(self, domain: Domain) -> Domain:
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
        """Where something truly is that is believed to lie on the table at a pose."""
        return Pose(pose.position + [0.0, 0.0, self.lift], pose.quaternion)


UNCHANGED = SceneChange()
