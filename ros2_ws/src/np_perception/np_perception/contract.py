"""The contract of a keypoint detector's weights. No ONNX Runtime: training writes it too."""

from __future__ import annotations

from dataclasses import dataclass

from np_description.domains import Task
from np_description.weights.contract import Contract, camera_intrinsics, keypoint_order


@dataclass(frozen=True)
class DetectorContract(Contract):
    """What a detector was trained for."""

    domain: str
    """Task family."""
    keypoint_order: tuple[str, ...]
    """Names of its keypoints in order."""
    camera: dict[str, float]
    """Size and intrinsics, px."""

    @classmethod
    def of(cls, domain: Task) -> DetectorContract:
        """The contract of a detector that fits the code as it is."""
        return cls(domain.name, keypoint_order(), camera_intrinsics())
