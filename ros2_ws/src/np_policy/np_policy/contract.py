"""The contract of the policies' weights: observation, action, and the arm, law and contacts that they were trained with.

No PyTorch: a command checks weights before it starts the nodes that load them.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

from np_control.impedance import DAMPING_RATIO_MAX, DAMPING_RATIO_MIN, STIFFNESS_MAX, STIFFNESS_MIN
from np_description.contact.definition import contact_definition
from np_description.domains import Task
from np_description.panda import NOMINAL
from np_description.weights.contract import (
    KEY,
    Contract,
    camera_intrinsics,
    keypoint_order,
    record_only,
    warn_on_mismatch,
)
from np_description.weights.header import read_metadata
from np_description.weights.released import WeightsError, weights_folder
from np_policy import action, hand_pose, observation

PRE_CONTACT, POST_CONTACT = KINDS = ("pre_contact", "post_contact")
CONTROLLERS = ("impedance", "osc")
_INTERFACES = {  # observation's version and size, action's version and size
    PRE_CONTACT: (observation.STUDENT_VERSION, observation.STUDENT_SIZE, hand_pose.VERSION, hand_pose.SIZE),
    POST_CONTACT: (observation.POST_VERSION, observation.POST_SIZE, action.VERSION, action.SIZE),
}


@dataclass(frozen=True)
class PolicyContract(Contract):
    """What a policy was trained for. All of it is a refusal where it differs, but for the last three.

    kind: of KINDS; observation_*, action_*: see np_policy.observation, action and hand_pose; interchangeable_faces: whether
    keypoints come under other names (np_description.symmetry); camera: size and intrinsics, px; controller: of CONTROLLERS,
    the law that follows the targets; policy_rate Hz; residual_limits m, rad a step; stiffness_range (2, 7) Nm/rad;
    damping_ratio_range; joint_limits: rad, rad/s, beyond which the reflex ended a training's episode.
    contact: see np_description.contact.definition; other contacts are a warning. For the record: control_rate Hz of the law
    in training, and target_delay s, the range of the time after which a target took effect there.
    """

    kind: str
    domain: str
    observation_version: int
    observation_size: int
    action_version: int
    action_size: int
    keypoint_order: tuple[str, ...]
    interchangeable_faces: bool
    camera: dict[str, float]
    controller: str
    policy_rate: float
    residual_limits: dict[str, float] = record_only()
    stiffness_range: tuple[list[float], list[float]]
    damping_ratio_range: tuple[float, float] = record_only()  # `compare` checks it
    joint_limits: dict[str, list[float]]
    contact: dict[str, object] = warn_on_mismatch("was trained under other contacts than those of this scene")
    control_rate: float | None = record_only(default=None)
    target_delay: tuple[float, float] | None = record_only(default=None)

    def check(self, path: str | Path) -> list[str]:
        """As of every contract; of an .onnx file too."""
        return self.compare(policy_metadata(path).get(KEY), path)

    def compare(self, text: str | None, path: str | Path) -> list[str]:
        """As of every contract; the range of damping ratios has to lie within this one's."""
        warnings = super().compare(text, path)
        low, high = json.loads(text).get("damping_ratio_range", (0.0, 0.0))
        if not self.damping_ratio_range[0] <= low < high == self.damping_ratio_range[1]:
            raise WeightsError(
                f"weights: {path} were trained for something else: damping_ratio_range: expected one within "
                f"{list(self.damping_ratio_range)} up to its end, got {[low, high]}"
            )
        return warnings

    @classmethod
    def of(
        cls, kind: str, domain: Task, controller: str = "impedance", policy_rate: float = action.RATE, **notes
    ) -> PolicyContract:
        """The contract of weights that fit the code as it is. Raises ValueError for an unknown kind or controller."""
        for name, value, allowed in (("kind", kind, KINDS), ("controller", controller, CONTROLLERS)):
            if value not in allowed:
                raise ValueError(f"{name}: expected one of {', '.join(allowed)}, got {value!r}")
        return cls(
            kind,
            domain.name,
            *_INTERFACES[kind],
            keypoint_order=keypoint_order(),
            interchangeable_faces=domain.interchangeable,
            camera=camera_intrinsics(),
            controller=controller,
            policy_rate=float(policy_rate),
            residual_limits={
                "position": action.RESIDUAL_LIMITS_FINAL.position,
                "rotation": action.RESIDUAL_LIMITS_FINAL.rotation,
            },
            stiffness_range=(STIFFNESS_MIN.tolist(), STIFFNESS_MAX.tolist()),
            damping_ratio_range=(DAMPING_RATIO_MIN, DAMPING_RATIO_MAX),
            joint_limits={
                name: getattr(NOMINAL, name).tolist() for name in ("position_lower", "position_upper", "velocity_limit")
            },
            contact=contact_definition(domain),
            **notes,
        )


def policy_metadata(path: str | Path) -> dict[str, str]:
    """The metadata of a policy's file, .safetensors or .onnx. Raises WeightsError if it is missing or broken."""
    if Path(path).suffix != ".onnx":
        return read_metadata(path)
    from np_policy.onnx.runtime import open_session  # ONNX Runtime takes a third of a second to load

    return open_session(path).get_modelmeta().custom_metadata_map


def residual_limits(path: str | Path) -> action.ResidualLimits:
    """zeta* of post-contact weights: the limits of one step that they were trained with, by the contract in their file.

    Raises WeightsError where the contract has none, or some that are not positive.
    """
    found = json.loads(policy_metadata(path)[KEY]).get("residual_limits")
    try:
        limits = action.ResidualLimits(float(found["position"]), float(found["rotation"]))
    except (TypeError, KeyError, ValueError) as error:
        raise WeightsError(
            f"weights: {path}: residual_limits: expected position m, rotation rad, got {found!r}"
        ) from error
    if not (0 < limits.position < 1 and 0 < limits.rotation < 1):
        raise WeightsError(f"weights: {path}: residual_limits: expected numbers between 0 and 1, got {found!r}")
    return limits


def weights_file(kind: str, domain: Task, folder: str | Path = "") -> Path:
    """The file with the weights of a kind for a domain: .safetensors, or .onnx in a folder that has only that.

    folder: as for `np_description.weights.released.weights_folder`. Raises WeightsError if there is no folder.
    """
    file = weights_folder(folder) / f"{kind}_{domain.name}.safetensors"
    exported = file.with_suffix(".onnx")
    return exported if exported.is_file() and not file.is_file() else file


def damping_floor(path: str | Path) -> float:
    """The least damping ratio of actions of checked weights."""
    return json.loads(policy_metadata(path)[KEY])["damping_ratio_range"][0]


def check_weights(domain: Task, folder: str | Path = "") -> list[str]:
    """Hold the contracts of a domain's two policies against what this graph would be; the warnings. Raises WeightsError."""
    return [
        warning
        for kind in KINDS
        for warning in PolicyContract.of(kind, domain).check(weights_file(kind, domain, folder))
    ]
