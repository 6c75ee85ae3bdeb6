"""rigid_body: masses, their places, their inertia, gravity. Effects of the whole arm: they show in every joint
at and before the link, in r2."""

from __future__ import annotations

import numpy as np

from np_diagnosis.arm import rigid
from np_diagnosis.arm.model import INERTIA_ERROR, SURE
from np_diagnosis.effects.base import Context, Effect, Parameter, stack


def effects(context: Context) -> list[Effect]:
    """Effects that the joints show together."""
    arm = context.arm
    last = len(arm) - 1
    link_columns = [rigid.regressor(arm, context.prediction.motion, i) for i in range(len(arm))]
    x, y, z = arm.tip
    point = np.array([1.0, x, y, z, y * y + z * z, -x * y, x * x + z * z, -x * z, -y * z, x * x + y * y])
    found = [
        Effect(
            "payload",
            (Parameter("mass", "kg", 0.0, 5.0, 0.3),),  # a hand that is not there is another nominal arm
            {"r2": lambda c, j: stack(link_columns[last][:, j] @ point)},
            "a point mass at the tool point",
            is_arm=True,
        ),
        Effect(
            "gravity_compensation_error",
            (Parameter("scale", "1", -0.3, 0.3, 0.03),),
            {"r2": lambda c, j: stack(-c.prediction.gravity[:, j])},
            "scale of the compensated gravity",
            is_arm=True,
        ),
        _tilt(context),
    ]
    # A joint feels the errors of all links that it turns: one link's can be told from those of the others only
    # where it is larger than they are together.
    own = rigid.own_sizes(arm)
    known = SURE * INERTIA_ERROR * np.linalg.norm(own) / np.maximum(own, 1e-9)
    for i in range(len(arm)):
        moments = tuple(Parameter(f"moment_{axis}", "kg m", -0.15, 0.15, 0.05) for axis in "xyz")
        table = link_columns[i]
        found.append(
            Effect(
                "link_com",
                moments,
                {"r2": lambda c, j, t=table: t[:, j, 1:4]},
                "inverse dynamics are linear in m c",
                f"link {i + 1}",
                is_arm=True,
                component=arm.joints[i],
            )
        )
        found.append(
            Effect(
                "link_inertia",
                (Parameter("scale", "1", -0.9, 5.0, 0.5, least=min(known[i], 2.0)),),
                {"r2": lambda c, j, i=i: stack(c.prediction.inertia[:, j, i])},
                "inverse dynamics are linear in the inertia about the centre of mass",
                f"link {i + 1}",
                is_arm=True,
                component=arm.joints[i],
            )
        )
    return found


def _tilt(context: Context) -> Effect:
    """Gravity turned about the base's x and y axis, by small angles."""
    arm, q = context.arm, context.samples.position
    size = np.linalg.norm(arm.gravity)
    about_x = rigid.gravity_torque(arm, q, np.array([0.0, -size, 0.0]))
    about_y = rigid.gravity_torque(arm, q, np.array([size, 0.0, 0.0]))
    return Effect(
        "base_tilt",
        (Parameter("roll", "rad", -0.2, 0.2, 0.01), Parameter("pitch", "rad", -0.2, 0.2, 0.01)),
        {"r2": lambda c, j: stack(about_x[:, j], about_y[:, j])},
        "gravity in the frame of a base that stands crooked",
        is_arm=True,
    )
