"""A goal in words, by which `episode` says in its diagnostics which one it has, and who gave one sees that it was taken."""

from __future__ import annotations

from geometry_msgs.msg import PoseStamped

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
