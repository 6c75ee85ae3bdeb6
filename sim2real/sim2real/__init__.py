"""Sim-to-real diagnosis of a robot arm, without ROS: `print(diagnose([load_bag(path)]).summary())`.

Names are imported when they are first used: a command may set up its process before NumPy is loaded (`single_thread`).
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sim2real.arm.files import load_arm
    from sim2real.arm.model import panda
    from sim2real.consequences import follow_up
    from sim2real.diagnosis import Diagnosis, diagnose
    from sim2real.effects.patch import load_patch
    from sim2real.finding import Finding
    from sim2real.recordings.reading import ContractViolation, load_bag, load_log, load_npz
    from sim2real.recordings.signals import Log
    from sim2real.report.document import write_report

_MODULES = {
    "load_arm": "arm.files",
    "panda": "arm.model",
    "Diagnosis": "diagnosis",
    "diagnose": "diagnosis",
    "load_patch": "effects.patch",
    "Finding": "finding",
    "follow_up": "consequences",
    "ContractViolation": "recordings.reading",
    "load_bag": "recordings.reading",
    "load_log": "recordings.reading",
    "load_npz": "recordings.reading",
    "Log": "recordings.signals",
    "write_report": "report.document",
}
__all__ = [
    "ContractViolation",
    "Diagnosis",
    "Finding",
    "Log",
    "diagnose",
    "follow_up",
    "load_arm",
    "load_bag",
    "load_log",
    "load_npz",
    "load_patch",
    "panda",
    "write_report",
]


def __getattr__(name: str):
    if name not in _MODULES:
        raise AttributeError(f"module 'sim2real' has no attribute {name!r}")
    return getattr(import_module(f"sim2real.{_MODULES[name]}"), name)
