"""Fixtures of the graph tests. Without an installed workspace the packages are used from source."""

import os
import signal
import sys
from pathlib import Path

import pytest
from hypothesis import settings

# How long an example takes says how busy the machine is, nothing else.
settings.register_profile("np", deadline=None)
settings.load_profile("np")

# A shell's background job ignores interrupts, and what it starts inherits that; what the tests interrupt must not.
signal.signal(signal.SIGINT, signal.default_int_handler)

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT / "tests"), str(ROOT / "tools")]

try:
    import np_bringup  # noqa: F401
except ImportError:
    sources = [str(p) for p in sorted((ROOT / "ros2_ws" / "src").iterdir())] + [str(ROOT / "training")]
    sys.path[:0] = sources
    os.environ["PYTHONPATH"] = os.pathsep.join([*sources, os.environ.get("PYTHONPATH", "")])


# Of two workers that take file by file, none begins a minute's work when the other has nothing left.
LONGEST = ("test_commands", "test_distributed", "test_reproducible", "test_diagnosis", "test_faults")


def pytest_collection_modifyitems(items):
    """The longest files first."""
    items.sort(key=lambda item: LONGEST.index(item.path.stem) if item.path.stem in LONGEST else len(LONGEST))


@pytest.fixture
def graph(tmp_path):
    """Starts nodes as processes in a ROS domain of the test's own."""
    from graph_tools import Graph

    with Graph(tmp_path / "log") as graph:
        yield graph


@pytest.fixture
def probe(graph):
    """A node of the test in the domain of `graph`."""
    from graph_tools import Probe

    probe = Probe(graph)
    yield probe
    probe.close()


@pytest.fixture(scope="session")
def untrained(tmp_path_factory):
    """A folder with untrained weights of every network of the card graph."""
    from random_weights import write_weights

    return write_weights(tmp_path_factory.mktemp("weights"))
