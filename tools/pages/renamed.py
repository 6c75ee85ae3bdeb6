"""What commands are called now: data say them as they were run."""

from __future__ import annotations

import re

RENAMED = {
    "np_blind.blind": "np_blind.arm.set",
    "np_blind.generate": "np_blind.arm.generate",
    "np_blind.regression": "np_blind.arm.regression",
    "np_blind.task_set": "np_blind.chain.set",
    "np_blind.task_others": "np_blind.chain.others",
    "np_blind.task_put_down": "np_blind.chain.put_down",
    "np_blind.task_harm": "np_blind.chain.harm",
    "np_blind.task_cma": "np_blind.chain.others --methods cma",
    "np_blind.robot_set": "np_blind.robots.set",
    "np_blind.robot_matrix": "np_blind.robots.matrix",
    "np_blind.views": "np_blind.camera.views",
    "np_blind.clocks": "np_blind.camera.clocks",
}
"""Since 2026-11-26: the blind test's modules stand in rooms."""


def now(command: str) -> str:
    """A sentence for each renamed command in `command`, "" where everything is called as it was."""
    names = [name for name in RENAMED if re.search(rf"\b{re.escape(name)}\b", command)]
    return " ".join(f"`{name}` is called `{RENAMED[name]}` now." for name in names)
