"""The trained policies as the nodes use them: keypoints in, hand poses and gains out. Pixels in, SI units out.

Inference is single-threaded on one sample, so that equal inputs give equal bits: PyTorch for .safetensors, ONNX Runtime
for .onnx, which does without PyTorch.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from np_common.rotations import matrix_from_quaternion, quaternion_from_matrix
from np_control.kinematics import forward_kinematics
from np_description.camera import CAMERA, Camera
from np_description.domains import Pose, Task
from np_description.objects.choice import DEFAULT
from np_perception.pose_estimation import (
    PoseError,
    estimate_pose,
    has_enough_keypoints,
    project_keypoints,
    usable_keypoints,
)
from np_policy import action, hand_pose
from np_policy.action import PolicyError
from np_policy.contract import (
    POST_CONTACT,
    PRE_CONTACT,
    PolicyContract,
    damping_floor,
    policy_metadata,
    residual_limits,
)
from np_policy.size_generalization import (
    canonical_object_position,
    find_trained_domain,
    read_size_range,
    transfer_contact_position,
)


@dataclass(frozen=True)
class PreContact:
    """pose: target of T_E before contact, in the base frame; opening: of each finger, m."""

    pose: Pose
    opening: float


def student_output(output) -> PreContact:
    """What the student's output (10,) means. Raises PolicyError if it is not finite or gives no rotation."""
    output = np.asarray(output, float)
    first, second = output[:3], output[3:6]
    spread = np.linalg.norm(np.cross(first, second))
    if not np.isfinite(output).all() or spread <= 1e-6 * np.linalg.norm(first) * np.linalg.norm(second):
        raise PolicyError(f"pre-contact policy: expected 10 finite numbers that give a rotation, got {output.tolist()}")
    position, rotation, opening = hand_pose.decode(output)
    return PreContact(Pose(position, quaternion_from_matrix(rotation)), float(opening))


class PreContactPolicy:
    """The pre-contact student.

    min_score: of keypoints that are used; policy_rate Hz: of the graph that it is to run in. `warnings`: how its
    weights' contract differs from that graph without being refused. Raises WeightsError if the weights are missing or do not fit.
    """

    def __init__(
        self,
        file: str | Path,
        domain: Task,
        *,
        min_score: float = 0.3,
        camera: Camera = CAMERA,
        policy_rate: float = action.RATE,
    ) -> None:
        contract = PolicyContract.of(PRE_CONTACT, domain, policy_rate=policy_rate)
        self.warnings, metadata = contract.check(file), policy_metadata(file)
        self._domain, self._camera, self._min_score = domain, camera, min_score
        self._known = find_trained_domain(domain, metadata.get("object", DEFAULT), read_size_range(metadata))
        self._network = _load_network(file, PRE_CONTACT, self._known or domain, contract)

    def propose(self, keypoints, goal) -> PreContact:
        """From keypoints and goal keypoints (8, 3): u px, v px, score. Raises PolicyError.

        For an object of another size than the weights were trained with, `np_policy.size_generalization` chooses the pose.
        """
        if self._known is None:
            return self._choose(keypoints, goal)
        try:
            object_pose, end = (
                estimate_pose(points, self._domain, min_score=self._min_score, camera=self._camera).pose
                for points in (keypoints, goal)
            )
            shown = (
                Pose(
                    canonical_object_position(self._domain, self._known, pose.position, pose.quaternion),
                    pose.quaternion,
                )
                for pose in (object_pose, end)
            )
            chosen = self._choose(*(project_keypoints(self._known, pose, self._camera) for pose in shown))
        except (PoseError, ValueError) as error:
            raise PolicyError(
                f"pre-contact policy: expected keypoints with a pose, for a size it was not trained with: {error}"
            ) from error
        hand, rotation = chosen.pose.position, matrix_from_quaternion(chosen.pose.quaternion)
        there = transfer_contact_position(
            self._domain, self._known, object_pose.position, object_pose.quaternion, hand, rotation, chosen.opening
        )
        return replace(chosen, pose=Pose(there, chosen.pose.quaternion))

    def _choose(self, keypoints, goal) -> PreContact:
        return student_output(self._network(*(np.asarray(points)[:, :2] for points in (keypoints, goal))))


RETREAT_HEIGHT = 0.25  # m, of T_E: above what an upright hand hides from the nominal camera
RETREAT_ACTION = np.eye(action.SIZE)[2]
"""As fast as the residual's limit lets the hand rise, gains in the middle of their ranges."""


class PostContactPolicy:
    """The post-contact policy with its memory: the last action and the last good keypoints.

    reobserve_after: number of decisions in a row without enough usable keypoints, after which the hand is drawn up; 0: never. It leaves
    the object and the camera's view, until there are enough or it is RETREAT_HEIGHT high. policy_rate, `warnings`: as for PreContactPolicy. Raises WeightsError if its weights are missing or do not fit.
    """

    def __init__(
        self,
        file: str | Path,
        domain: Task,
        *,
        min_score: float = 0.3,
        camera: Camera = CAMERA,
        policy_rate: float = action.RATE,
        reobserve_after: int = 5,
    ) -> None:
        contract = PolicyContract.of(POST_CONTACT, domain, policy_rate=policy_rate)
        self.warnings = contract.check(file)
        self._network = _load_network(file, POST_CONTACT, domain, contract)
        self._limits = residual_limits(file)
        self._damping_floor = damping_floor(file)
        self._domain, self._camera, self._min_score = domain, camera, min_score
        self._reobserve_after = reobserve_after
        self.reset()

    def reset(self) -> None:
        """Forget the last episode."""
        self.last_action = np.zeros(action.SIZE)
        self._keypoints: np.ndarray | None = None
        self._blind = 0  # decisions in a row

    def act(self, q, dq, keypoints, goal) -> action.Target:
        """One policy step.

        q, dq (9,): joints rad, rad/s, fingers m, m/s; keypoints (8, 3) u px, v px, score, or None if there were none
        worth reading; goal (8, 3). Without any keypoints since `reset` the target is the pose of now. Raises
        PolicyError.
        """
        position, rotation = forward_kinematics(np.asarray(q, float)[:7])
        self._blind = 0 if has_enough_keypoints(keypoints, self._min_score) else self._blind + 1
        if self._reobserve_after and self._blind > self._reobserve_after:
            self.last_action = RETREAT_ACTION if position[2] < RETREAT_HEIGHT else np.zeros(action.SIZE)
            return action.decode(self.last_action, position, rotation, self._limits, self._damping_floor)
        seen = self._fill(keypoints)
        if seen is None:
            return action.decode(np.zeros(action.SIZE), position, rotation, self._limits, self._damping_floor)
        chosen = self._network(q, dq, seen, np.asarray(goal)[:, :2], self.last_action)
        if not np.isfinite(chosen).all():
            raise PolicyError(f"post-contact policy: expected 20 finite numbers, got {chosen.tolist()}")
        self.last_action = chosen
        return action.decode(chosen, position, rotation, self._limits, self._damping_floor)

    def _fill(self, keypoints) -> np.ndarray | None:
        """Pixels (8, 2): those seen well, the others from the pose that explains them, or as they were last."""
        if keypoints is None:
            return self._keypoints
        keypoints = np.asarray(keypoints, float)
        good = usable_keypoints(keypoints, self._min_score)
        pixels = keypoints[:, :2]
        if not good.all():
            try:
                estimate = estimate_pose(keypoints, self._domain, min_score=self._min_score, camera=self._camera)
                others = project_keypoints(self._domain, estimate.pose, self._camera)[:, :2]
            except (PoseError, ValueError):
                others = self._keypoints if self._keypoints is not None else pixels
            pixels = np.where(good[:, None], pixels, others)
        self._keypoints = pixels
        return pixels


def _load_network(file: str | Path, kind: str, domain: Task, contract: PolicyContract) -> Callable[..., np.ndarray]:
    if Path(file).suffix == ".onnx":
        from np_policy.onnx.session import load_network

        return load_network(file, kind, domain)
    from np_policy.torch_network import load_network  # PyTorch takes seconds to load

    return load_network(file, kind, domain, contract)
