"""`colcon test` calls pytest in the folder of each package; its tests lie in tests/, by kind.

A folder of a package stands for the tests without a graph that belong to it (tests/packages.py): also
`python -m pytest ros2_ws/src/np_control`.
"""

import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests"))


def pytest_configure(config: pytest.Config) -> None:
    """Put a package's tests in the place of its folder."""
    from packages import PACKAGES, own_tests

    folders = {folder: name for name, folder in PACKAGES.items()}
    args = []
    for arg in config.args:
        package = folders.get((config.invocation_params.dir / arg).resolve())
        args += [str(path) for path in own_tests(package)] if package else [arg]
    config.args = args
