"""What any arm is off by, so that it is no effect worth naming; standard deviations."""

INERTIA_ERROR = 0.03  # of a link's inertia about its centre of mass: CAD without cables and glue
MASS_ERROR = 0.03  # of a link's mass, likewise; its inertia about every joint is off by as much
PLACE_ERROR = 0.03  # of the distance of its centre of mass from its joint, along each axis
WEIGHT_KNOWN = 0.05  # of the torque of a joint's load, from masses and places as far off: half of a 95 % interval
SURE = 2.0  # standard deviations of what any arm's links are off by together, up to which it is no effect
