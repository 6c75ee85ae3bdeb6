"""The effects that a torque residual can show: equation, parameters, regressor columns.

An effect is a column of torque for each of its parameters: residual = columns @ parameters. The residual is
measured torque minus what the nominal simulator says the motion takes, so parameters are changes against the
nominal simulator. Ids, modules and equations are those of data/gap_effects.yaml.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from importlib.resources import files

import numpy as np
import yaml

from np_description.panda import NOMINAL

from np_diagnosis.nominal import PARAMETERS, Prediction, sign
from np_diagnosis.signals import Samples

JOINTS = len(NOMINAL.joints)


@dataclass(frozen=True)
class Parameter:
    """A change against the nominal simulator, from lower to upper, N(0, prior^2) before any data."""

    name: str
    unit: str
    lower: float
    upper: float
    prior: float


@dataclass(frozen=True)
class Effect:
    """One effect. columns(samples, prediction, joint) -> torque (n, parameters) of that joint, Nm per unit.

    An effect of one joint acts on that joint only; columns of an effect of the whole arm (`is_arm`) are
    evaluated for every joint with the same parameters. shape: what distinguishes variants that share an id
    (a velocity scale, the link), in words. component: of an arm effect, the joint it sits at, or "arm".
    """

    id: str
    parameters: tuple[Parameter, ...]
    columns: Callable[[Samples, Prediction, int], np.ndarray]
    source: str
    shape: str = ""
    is_arm: bool = False
    component: str = "arm"

    @property
    def entry(self) -> dict:
        """This effect in the catalogue: module, model, exciting_experiment, ..."""
        return catalogue()[self.id]

    @property
    def key(self) -> str:
        """Name that tells variants apart."""
        return f"{self.id}[{self.shape}]" if self.shape else self.id


@cache
def catalogue() -> dict[str, dict]:
    """The catalogue by id."""
    return {entry["id"]: entry for entry in _data()["effects"]}


@cache
def equivalence_classes() -> tuple[tuple[frozenset[str], str], ...]:
    """Ids that one data set may not tell apart, and what splits them."""
    return tuple((frozenset(entry["members"]), entry["split_by"]) for entry in _data()["equivalence_classes"])


@cache
def _data() -> dict:
    return yaml.safe_load((files("np_diagnosis") / "data" / "gap_effects.yaml").read_text(encoding="utf-8"))


GAZ = "Gaz et al., RA-L 2019"
COULOMB = ("Nm", -1.0, 2.0, 0.3)
VISCOUS = ("Nms/rad", -1.0, 3.0, 0.3)
STRIBECK_SPEEDS = (0.03, 0.1, 0.2)  # rad/s
PRESLIDING_STROKES = (0.003, 0.01, 0.03)  # rad


def joint_effects() -> list[Effect]:
    """Effects of a single joint."""
    effects = [
        Effect(
            "coulomb_friction",
            (Parameter("level", *COULOMB),),
            lambda s, p, j: _stack(p.direction[:, j]),
            GAZ,
        ),
        Effect(
            "asymmetric_coulomb_friction",
            (Parameter("level_positive", *COULOMB), Parameter("level_negative", *COULOMB)),
            lambda s, p, j: _stack(
                s.filtered(j, lambda q, v: np.maximum(sign(v), 0)),
                s.filtered(j, lambda q, v: np.minimum(sign(v), 0)),
            ),
            GAZ,
        ),
        Effect(
            "viscous_friction",
            (Parameter("coefficient", *VISCOUS),),
            lambda s, p, j: _stack(s.velocity[:, j]),
            GAZ,
        ),
        Effect(
            "asymmetric_viscous_friction",
            (Parameter("coefficient_positive", *VISCOUS), Parameter("coefficient_negative", *VISCOUS)),
            lambda s, p, j: _stack(
                s.filtered(j, lambda q, v: np.maximum(v, 0)), s.filtered(j, lambda q, v: np.minimum(v, 0))
            ),
            GAZ,
        ),
        Effect(
            "load_dependent_friction",
            (Parameter("coefficient", "1", -0.1, 0.3, 0.05),),
            lambda s, p, j: _stack(np.abs(p.load[:, j]) * p.direction[:, j]),
            "friction proportional to the load through the gear",
        ),
        Effect(
            "torque_offset",
            (Parameter("offset", "Nm", -3.0, 3.0, 0.5),),
            lambda s, p, j: np.ones((len(s), 1)),
            GAZ,
        ),
        Effect(
            "torque_scale",
            (Parameter("scale", "1", -0.2, 0.2, 0.03),),
            lambda s, p, j: _stack(p.load[:, j]),
            "gain of the torque loop or its sensor",
        ),
        Effect(
            "armature",
            (Parameter("inertia", "kg m^2", -0.2, 1.0, 0.1),),
            lambda s, p, j: _stack(s.acceleration[:, j]),
            "inertia of the rotor, reflected",
        ),
        Effect(
            "cable_torque",
            (Parameter("stiffness", "Nm/rad", -1.0, 1.0, 0.2), Parameter("offset", "Nm", -3.0, 3.0, 0.5)),
            lambda s, p, j: _stack(s.position[:, j] - NOMINAL.ready[j], np.ones(len(s))),
            "spring about the ready posture",
        ),
    ]
    effects += [
        Effect(
            "stribeck_friction",
            (Parameter("coulomb", *COULOMB), Parameter("breakaway", "Nm", -0.5, 1.0, 0.2)),
            lambda s, p, j, scale=scale: _stack(
                p.direction[:, j], s.filtered(j, lambda q, v: sign(v) * np.exp(-((v / scale) ** 2)))
            ),
            "Armstrong-Helouvry et al., Automatica 1994",
            f"{scale} rad/s",
        )
        for scale in STRIBECK_SPEEDS
    ]
    effects += [
        Effect(
            "presliding_friction",
            (Parameter("level", *COULOMB),),
            lambda s, p, j, stroke=stroke: _stack(s.filtered(j, lambda q, v: _dahl(q, stroke))),
            "Dahl 1968: dF/dx = (Fc - F sgn v) / x0",
            f"{1e3 * stroke:g} mrad",
        )
        for stroke in PRESLIDING_STROKES
    ]
    return effects


def arm_effects() -> list[Effect]:
    """Effects that the joints show together."""
    effects = [
        Effect(
            "payload",
            (Parameter("mass", "kg", -0.8, 3.0, 0.3),),
            _payload,
            "a point mass at T_E",
            is_arm=True,
        ),
        Effect(
            "gravity_compensation_error",
            (Parameter("scale", "1", -0.2, 0.2, 0.03),),
            lambda s, p, j: _stack(p.gravity[:, j]),
            "scale of the compensated gravity",
            is_arm=True,
        ),
    ]
    for link in range(JOINTS):
        component, first = NOMINAL.joints[link], PARAMETERS * link
        moments = tuple(Parameter(f"first_moment_{axis}", "kg m", -0.5, 0.5, 0.05) for axis in "xyz")
        inertia = tuple(
            Parameter(f"inertia_{axes}", "kg m^2", -1.0, 1.0, 0.05)
            for axes in ("xx", "xy", "yy", "xz", "yz", "zz")
        )
        bias = (Parameter("bias", "rad", -0.05, 0.05, 0.005),)
        where = f"link {link + 1}"
        effects += [
            Effect(
                "link_com",
                moments,
                lambda s, p, j, a=first + 1: p.regressor[:, j, a : a + 3],
                "inverse dynamics are linear in m c",
                where,
                True,
                component,
            ),
            Effect(
                "link_inertia",
                inertia,
                lambda s, p, j, a=first + 4: p.regressor[:, j, a : a + 6],
                "inverse dynamics are linear in the inertia about the joint",
                where,
                True,
                component,
            ),
            Effect(
                "encoder_bias",
                bias,
                lambda s, p, j, k=link: -p.gravity_slope[:, j, k : k + 1],
                "gravity torque at q - b, to first order",
                f"joint {link + 1}",
                True,
                component,
            ),
        ]
    return effects


def nuisances(samples: Samples, prediction: Prediction, joint: int) -> tuple[np.ndarray, np.ndarray]:
    """What every candidate may use besides its own: (columns (n, 2), priors (2,)).

    A delay of the torque against the motion (first order; s, prior 1 ms), and an error of the joint's
    inertial torque (prior 3 %).
    """
    return (
        _stack(samples.torque_rate[:, joint], prediction.inertial[:, joint] + prediction.rotors[:, joint]),
        np.array([1e-3, 0.03]),
    )


def _stack(*columns: np.ndarray) -> np.ndarray:
    return np.column_stack(columns)


def _dahl(position: np.ndarray, stroke: float) -> np.ndarray:
    """Dahl's friction (m,) over its level, -1..1, from the distance moved; exact for motion that does not
    turn
    between two samples."""
    moved = np.diff(position, prepend=position[:1])
    friction, state = [], 0.0
    for direction, decay in zip(np.sign(moved).tolist(), np.exp(-np.abs(moved) / stroke).tolist()):
        state = direction + (state - direction) * decay
        friction.append(state)
    return np.array(friction)


@cache
def _tcp_in_link7() -> np.ndarray:
    """T_E (3,) m in the frame of the last link, which turns about its own z axis through T_E."""
    hand, tcp = NOMINAL.frames["link7_hand"], NOMINAL.frames["hand_tcp"]
    return hand.position + tcp.position


def _payload(samples: Samples, prediction: Prediction, joint: int) -> np.ndarray:
    x, y, z = _tcp_in_link7()
    unit = np.array([1.0, x, y, z, y * y + z * z, -x * y, x * x + z * z, -x * z, -y * z, x * x + y * y])
    return _stack(prediction.regressor[:, joint, -PARAMETERS:] @ unit)
