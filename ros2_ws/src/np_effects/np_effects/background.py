"""What any arm is off by, so that it is no effect worth naming."""

INERTIA_ERROR = 0.03  # standard deviation of a link's inertia about its centre of mass: CAD without cables and glue
SURE = 2.0  # standard deviations of what any arm's links are off by together, up to which it is no effect
