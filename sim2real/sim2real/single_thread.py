"""For commands that import it first: NumPy in one thread, MuJoCo without windows.

The matrices of the diagnosis are so small that two threads of OpenBLAS mostly wait for each other: 1 s of CPU more for a
quick look, no less time on two idle cores, and 28 s in place of 8 where others use them too. With one thread the
last digits do not depend on the number of cores either. MuJoCo looks for a library of windows in a process of its
own, a tenth of a second. Where NumPy is imported already, as in tests, nothing happens; a variable that is set
stays as it is; and the environment that other processes inherit is that of before.
"""

from __future__ import annotations

import os
import sys
from importlib import import_module

FIRST = {"OPENBLAS_NUM_THREADS": ("1", "numpy"), "MUJOCO_GL": ("disable", "mujoco")}
"""Variable -> what it is when this module is imported for the first time."""

if "numpy" not in sys.modules:
    for name, (value, module) in FIRST.items():
        if name not in os.environ:
            os.environ[name] = value
            try:
                import_module(module)
            finally:
                del os.environ[name]
