"""Domain randomisation: what varies between episodes and between steps. Three sets have names; a recipe or `--set` changes fields of one."""

from __future__ import annotations

import ast
import dataclasses
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

DELAY_STEP = 0.005  # s, of `Conditions.delay`
Range = tuple[float, float]
_OF_THE_MODEL = (
    *("table_friction", "finger_friction", "housing_friction", "mass", "centre"),
    *("joint_friction", "joint_damping", "armature"),
    *("stiffness", "damping", "time_constant", "friction_stiffness", "onset"),
)


@dataclass(frozen=True)
class Conditions:
    """What is drawn for an episode or a step. A range of a factor is (least, most); (1, 1) leaves the nominal value."""

    table_friction: Range = (1.0, 1.0)
    """Factor of the friction of table and obstacles."""
    finger_friction: Range = (1.0, 1.0)
    """Factor of the friction of the fingertips."""
    housing_friction: Range = (1.0, 1.0)
    """Factor of the friction of housing and links."""
    mass: Range = (1.0, 1.0)
    """Factor of the object's mass, drawn evenly in its logarithm."""
    size: Range = (1.0, 1.0)
    """Factor of each of the object's edges, each drawn for itself; the mass stays."""
    centre: float = 0.0
    """Largest distance of the object's centre of mass from its middle, as a share of each edge."""
    joint_friction: Range = (1.0, 1.0)
    """Factor of the friction of each joint, drawn evenly in its logarithm."""
    joint_damping: Range = (1.0, 1.0)
    """Factor of the damping of each joint, drawn evenly in its logarithm."""
    armature: Range = (1.0, 1.0)
    """Factor of the armature of each joint, drawn evenly in its logarithm."""
    delay: tuple[int, int] = (4, 4)
    """Time until a target takes effect, in steps of DELAY_STEP."""
    torque_noise: float = 0.0
    """Standard deviation a step, Nm."""
    keypoint_noise: float = 0.0
    """Standard deviation a step, normalised image units."""
    keypoint_bias: float = 0.0
    """Standard deviation an episode, normalised image units."""
    joint_noise: float = 0.0
    """Standard deviation a step, rad."""
    velocity_noise: float = 0.0
    """Standard deviation a step, rad/s."""
    start_position: float = 0.0
    """Largest distance along an axis by which an episode's start misses the chosen contact, m."""
    start_rotation: float = 0.0
    """Standard deviation of the start's rotation from the chosen contact, rad."""
    stiffness: Range = (1.0, 1.0)
    """Factor of every contact's stiffness, drawn evenly in its logarithm."""
    damping: Range = (1.0, 1.0)
    """Factor of every contact's damping ratio, drawn evenly in its logarithm."""
    time_constant: Range = (1.0, 1.0)
    """Factor of every contact's time constant, drawn evenly in its logarithm."""
    friction_stiffness: Range = (1.0, 1.0)
    """Factor of impratio, drawn evenly in its logarithm."""
    onset: Range = (0.0, 0.0)
    """How far every contact is on the way from the scene's definition (0) to HARD (1), where most of its force acts at first touch."""
    finger_length: float = 0.0
    """Largest distance by which a fingertip reaches further or less far, m."""
    finger_tilt: float = 0.0
    """Largest angle by which a fingertip's pad is turned about its sides, rad."""
    support: Range | None = None
    """Share of the sides of its face on which the object stands, each side for itself; None: on its corners."""
    limit_margin: Range = (1.0, 1.0)
    """Share of joint speed and range beyond which the reflex ends an episode, and of the torque to which commands are cut."""
    force_margin: Range = (1.0, 1.0)
    """Share of the force reflex's thresholds beyond which it ends an episode."""
    camera_position: float = 0.0
    """Standard deviation an episode of the camera's position, m."""
    camera_rotation: float = 0.0
    """Standard deviation an episode of the camera's rotation, rad."""
    goal_in_image: bool = False
    """Whether that camera sees the goal too, so that bringing the object onto it in the image suffices."""
    image_latency: Range = (0.0, 0.0)
    """Age of the keypoints, s, less than a policy period."""

    @property
    def randomises_physics(self) -> bool:
        """Whether a field of the model differs between worlds."""
        return any(getattr(self, name) != getattr(Conditions, name) for name in _OF_THE_MODEL)

    def at(self, strictness: float) -> Conditions:
        """These conditions grown from the nominal ones by a strictness in [0, 1].

        Ranges of factors grow in the logarithm, others evenly. `force_margin` and flags are whole at any strictness; a support shrinks from
        its largest share.
        """
        grown = {}
        for field in dataclasses.fields(self):
            target, nominal = getattr(self, field.name), field.default
            if field.name == "force_margin" or isinstance(target, bool) or target is None:
                grown[field.name] = target
            elif nominal == (1.0, 1.0):
                grown[field.name] = tuple(end**strictness for end in target)
            elif field.name == "delay":
                grown[field.name] = tuple(round((1 - strictness) * a + strictness * b) for a, b in zip(nominal, target))
            elif isinstance(target, tuple):
                nominal = (target[1], target[1]) if nominal is None else nominal
                grown[field.name] = tuple((1 - strictness) * a + strictness * b for a, b in zip(nominal, target))
            else:
                grown[field.name] = strictness * target
        return Conditions(**grown)

    @property
    def resizes(self) -> bool:
        """Whether objects have another size than their own."""
        return self.size != (1.0, 1.0)


NOMINAL_CONDITIONS = Conditions()

PAPER = Conditions(
    table_friction=(0.7, 1.3),
    finger_friction=(0.9, 1.1),
    mass=(0.7, 1.3),
    delay=(1, 8),
    torque_noise=0.03,
    keypoint_noise=0.03,
    keypoint_bias=0.01,
    joint_noise=0.01,
    velocity_noise=0.01,
    start_position=0.006,
    start_rotation=0.03,
)
"""Friction, mass, torque, keypoints and sensors are the paper's; delay, bias and start errors are ours."""

ROBUST = dataclasses.replace(
    PAPER,
    table_friction=(0.5, 2.0),
    finger_friction=(0.5, 2.0),
    housing_friction=(0.5, 2.0),
    mass=(0.1, 3.0),  # the paper's cards weigh 1 to 16 g, ours 8
    size=(0.8, 1.2),
    centre=0.15,
    # The friction that is measured on a Panda differs by this much between arms and with warmth.
    joint_friction=(0.5, 2.0),
    joint_damping=(0.5, 2.0),
    armature=(0.7, 1.4),
    # Towards what no simulator with steps has, bodies that do not give way.
    stiffness=(0.25, 10.0),
    # Of half the damping, steps of 4 ms throw a light card over the table, one in a hundred every second.
    damping=(1.0, 2.0),
    time_constant=(0.8, 2.5),
    friction_stiffness=(0.1, 3.0),
    # Enough for one finger to carry it all: a pad gives way by .1 mm under 5 N.
    finger_length=0.0003,
    finger_tilt=0.02,
    # A box on its corners turns like a disc of .70 of its side, a pressed patch like one of .38: .30 to .68.
    support=(0.43, 0.97),
    limit_margin=(0.7, 0.95),
    force_margin=(0.6, 1.0),
    # What our own calibration leaves (docs/results/calibration.md), rounded up; hand-eye routines leave more.
    camera_position=0.003,
    camera_rotation=0.003,
    image_latency=(0.0, 0.06),
)
"""The paper's, what no simulator knows of a contact, and other objects; with room to the limits at which a robot stops itself."""

CONDITIONS = {"nominal": NOMINAL_CONDITIONS, "paper": PAPER, "robust": ROBUST}
"""By the names that commands know."""


def find_conditions(name: str, changes: Mapping[str, object] | None = None) -> Conditions:
    """The set called `name` with fields changed: a number for a range gives both its ends.

    Raises ValueError for an unknown set or field, or a value of another kind.
    """
    if name not in CONDITIONS:
        raise ValueError(f"conditions: expected one of {', '.join(CONDITIONS)}, got {name!r}")
    kinds = {field.name: field.type for field in dataclasses.fields(Conditions)}
    fitting = {}
    for field, value in (changes or {}).items():
        if field not in kinds:
            raise ValueError(f"conditions: expected a field of {', '.join(kinds)}, got {field!r}")
        fitting[field] = _fitting(field, kinds[field], value)
    return dataclasses.replace(CONDITIONS[name], **fitting)


def _fitting(field: str, kind: str, value: object) -> object:
    number = isinstance(value, int | float) and not isinstance(value, bool)
    if kind.startswith(("Range", "tuple")):
        if number:
            return (value, value)
        if isinstance(value, list | tuple) and len(value) == 2 and value[0] <= value[1]:
            return tuple(value)
        if value is None and "None" in kind:
            return None
        raise ValueError(f"conditions: {field}: expected a number or least and most, got {value!r}")
    if isinstance(value, bool) != (kind == "bool") or not isinstance(value, bool | int | float):
        raise ValueError(f"conditions: {field}: expected a {kind}, got {value!r}")
    return value


def parse_changes(texts: Iterable[str]) -> dict[str, object]:
    """Fields by name of `field=value` texts, values as Python writes them. Raises ValueError for other texts."""
    changes = {}
    for text in texts:
        field, equals, value = text.partition("=")
        try:
            changes[field] = ast.literal_eval(value)
        except (ValueError, SyntaxError) as error:
            raise ValueError(f"--set: expected field=value, got {text!r}") from error
    return changes
