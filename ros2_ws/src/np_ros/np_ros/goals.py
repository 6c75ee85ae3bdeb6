"""The goal in force, as text in the diagnostics of `episode`: the sender of a goal sees there that it was taken."""

from __future__ import annotations

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped

from np_description.domains import Pose

GOAL = "goal"
"""Key of the diagnostics value."""
REFUSED = "goal_refused"
"""Key of the last goal that was not taken, and why not."""


def goal_text(message: PoseStamped) -> str:
    """Stamp ns, position m and quaternion (w, x, y, z) of a `goal_pose`; equal messages have equal texts."""
    stamp, p, q = message.header.stamp, message.pose.position, message.pose.orientation
    place = " ".join(f"{value:.4f}" for value in (p.x, p.y, p.z))
    turn = " ".join(f"{value:.4f}" for value in (q.w, q.x, q.y, q.z))
    return f"{place} m, {turn}, at {stamp.sec * 1_000_000_000 + stamp.nanosec} ns"


def episode_goal(message: DiagnosticArray) -> Pose | None:
    """The goal in force, where the message is from the node `episode` and names one; None otherwise.

    A late subscriber of `goal_pose` gets the last goal of each publisher that still runs, which may be another one.
    """
    for status in message.status:
        if status.name.rsplit("/", 1)[-1] == "episode":
            for pair in status.values:
                if pair.key == GOAL and " m, " in pair.value:
                    place, turn = pair.value.split(", ")[:2]
                    try:
                        return Pose(np.array(place.split()[:3], float), np.array(turn.split(), float))
                    except ValueError:
                        return None
    return None
