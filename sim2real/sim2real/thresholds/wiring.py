"""Thresholds of the wiring stage (`sim2real.wiring`): what contradicts a convention."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Wiring:
    """Contradictions between signals of joints."""

    moved: float = 0.05
    """rad between the ends of a joint's motion from which on its velocity and its effort must change."""
    wrap: float = 0.5
    """rad by which a step between two rows may be off a whole turn that wraps, and that the speed may make of it."""
    speed_floor: float = 0.01
    """rad/s; slower motion is no evidence on a velocity."""
    torque_floor: float = 0.004
    """Share of a joint's limit; smaller torques are no evidence: 0.35 Nm at a Panda's shoulder, 0.05 Nm at its wrist."""
    tracking: float = 0.15
    """rad by which a joint may be off its target while it stands still."""
    limit_slack: float = 0.05
    """rad by which a position may be beyond its limit."""
    turns: float = 3.0
    """Turns from zero of a joint without limits, at most."""
    gain: float = 0.3
    """Contradictions that a correction must remove, of joints times relations; a correction of a right recording adds some."""
    free_motion: float = 0.1
    """Share of the effort's variance, mean over joints, that may be unexplained where nothing touches the arm."""
    sharply: float = 10.0
    """Factor by which the right sample reduces the error of the law."""
    step_agreement: float = 0.05
    """Rise of the correlation of the effort's steps with the command's that shows another sample."""
    pose_position: float = 0.005
    """m between a target pose and forward kinematics of its joint target."""
    pose_angle: float = 0.05
    """rad between them."""
    least_poses: int = 10
    """Smallest number of target poses that determines a convention."""
    action_scale: float = 1.3
    """Factor of steps from which on the scale is wrong."""
    least_stamps: int = 10
    """Smallest number of messages that determines a clock."""
    latest: float = 0.5
    """s by which messages of one clock may be older than others on arrival."""
    earliest: float = 0.05
    """s by which messages may seem to arrive before they were stamped, against others."""
    drift: float = 1e-3
    """s a second; quartz clocks differ by less than a tenth of it."""
    drift_span: float = 5.0
    """s of a stream that determine a drift."""
    least_images: int = 5
    """Smallest number of images that determines a convention."""
    images: int = 12
    """Images whose keypoints are compared, at most."""
    detected: int = 4
    """Images that the detector looks at, at most."""
    corners: int = 6
    """Usable corners of an image that counts."""
    corner_error: float = 4.0
    """px by which corners may be off a box at rest; a camera that is turned by 3 degrees gives 2 px."""
    hand_distance: float = 0.04
    """m between the hand and an object that moves, beyond the object's reach."""
    clearly: float = 2.5
    """Factor by which another convention must reduce the error of the corners."""
    least_corner_error: float = 0.6
    """px RMS up to which corners are those of a box at rest, and no other convention is tried."""
    score: float = 0.05
    """Fall of the detector's mean score up to which another convention of the image is possible."""
