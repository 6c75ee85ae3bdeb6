"""SAPIEN, the library that PhysX comes in, from an extra of its own."""

from __future__ import annotations

import importlib.util
import warnings
from types import ModuleType

EXTRA = "the package sapien, which `make physx` installs"


def missing() -> str:
    """Why there is no PhysX here; empty where there is."""
    return "" if importlib.util.find_spec("sapien") else f"PhysX needs {EXTRA}"


def sapien() -> ModuleType:
    """The module sapien. Raises OSError where the extra is not installed."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of a missing Vulkan: nothing is drawn with it
        try:
            import sapien as library
        except ImportError as error:
            raise OSError(f"engine: expected {EXTRA} ({error})") from error
    return library
