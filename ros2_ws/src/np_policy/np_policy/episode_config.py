"""Settings of the phases of an episode."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from np_description.camera import CAMERA, Camera
from np_description.control_rate import SECOND
from np_description.domains import Task


@dataclass(frozen=True)
class EpisodeConfig:
    """domain; lockstep or real time; policy_period ns; limits of the phases in s, see docs/reference/graph.md.

    pre_timeout, post_blind: how long keypoints may be unusable; success_frames: ticks in a row within success_share of the
    tolerance, or within all of it when the time is over. Both require the pose's bounds inside the tolerance. contacts: how often
    a contact may be chosen, each with a post_timeout of its own (paper: 1); min_score: of a usable keypoint; camera: that sees
    them; camera_covariance: of its pose, (6, 6) m and rad, None where it is exactly there;
    silence, planning: how long by the wall clock nothing may come at all; arrival: rad that a joint may be off the plan's
    end for the arm to have arrived there.
    """

    domain: Task
    lockstep: bool = True
    policy_period: int = SECOND // 10
    pre_timeout: float = 2.0
    settle: float = 0.3
    post_timeout: float = 30.0
    post_blind: float = 1.0
    success_frames: int = 5
    success_share: float = 1.0
    contacts: int = 1
    min_score: float = 0.3
    silence: float = 30.0
    planning: float = 60.0
    arrival: float = 0.1
    camera: Camera = CAMERA
    camera_covariance: np.ndarray | None = None
