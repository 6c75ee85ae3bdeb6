"""What a policy's network is fed, from what is measured: pixels and SI units in, the observation out.

One definition for the nodes (NumPy) and for the graph that is exported to ONNX (PyTorch).
"""

from __future__ import annotations

from np_control.kinematics import forward_kinematics
from np_description.camera import CAMERA
from np_description.domains import Task
from np_description.symmetry import canonicalize_keypoints
from np_policy.observation import post_contact_observation, student_observation


def pre_contact_input(domain: Task, keypoints, goal_keypoints):
    """The student's observation (..., 32) of keypoints and goal keypoints (..., 8, 2), u px, v px, in the object's own order."""
    return student_observation(*_canonical(domain, keypoints, goal_keypoints))


def post_contact_input(domain: Task, q, dq, keypoints, goal_keypoints, last_action):
    """The post-contact observation (..., 79).

    q, dq (..., 9): 7 joints rad, rad/s and 2 fingers m, m/s; keypoints, goal_keypoints (..., 8, 2) u px, v px in the
    object's own order; last_action (..., 20).
    """
    here, there = _canonical(domain, keypoints, goal_keypoints)
    return post_contact_observation(q, dq, here, there, *forward_kinematics(q[..., :7]), last_action)


def _canonical(domain: Task, keypoints, goal_keypoints):
    """All cameras have the size of the nominal one: the weights' contract requires it."""
    return canonicalize_keypoints(domain, CAMERA.normalise(keypoints), CAMERA.normalise(goal_keypoints))
