"""Fixtures of the graph tests. Without an installed workspace the packages are used from source."""

import os
import signal
import sys
from importlib import import_module
from pathlib import Path

import pytest
from hypothesis import settings

# How long an example takes says how busy the machine is, nothing else. Continuous integration judges a change, not its luck: by
# Hypothesis's own profile for it a property has the same examples in every run.
settings.register_profile("np", deadline=None)
settings.load_profile("ci" if os.environ.get("CI") else "np")

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


# Of two workers that take file by file, none begins a minute's work when the other has nothing left. The second compiles the
# physics of training, a minute too, which files side by side would each do for themselves.
LONGEST = ("test_commands", "test_physics", "test_reproducible", "test_faults", "test_diagnosis")
LARGE = ("torch", "scipy.stats", "mujoco_warp", "matplotlib.pyplot")


def pytest_configure(config):
    """On a clean checkout every worker would compile the same 50 MB of Python: each begins with another package."""
    worker = os.environ.get("PYTEST_XDIST_WORKER", "")
    for n in range(len(LARGE) if worker else 0):
        import_module(LARGE[(n + int(worker.lstrip("gw"))) % len(LARGE)])


DEAD = pytest.StashKey[bool]()


def pytest_testnodedown(node, error):
    """A worker that died is remembered: after a few of them xdist passes over the tests that are left, and calls that failed tests."""
    if error:
        node.config.stash[DEAD] = True


def pytest_sessionfinish(session):
    """A run in which a worker died has another status than one of which tests failed: those can be asked once more."""
    if session.config.stash.get(DEAD, False):
        session.exitstatus = pytest.ExitCode.INTERNAL_ERROR


IN_REAL_TIME = ("graph", "contract")  # folders with tests of a graph in real time


def pytest_ignore_collect(collection_path, config):
    """Where only tests in real time are asked for, nothing else is imported."""
    is_folder = collection_path.parent == ROOT / "tests" and collection_path.is_dir()
    others = is_folder and collection_path.name not in IN_REAL_TIME
    return True if others and config.option.markexpr.startswith("real_time") else None


def pytest_collection_modifyitems(items):
    """Run the longest files first."""
    items.sort(key=lambda item: LONGEST.index(item.path.stem) if item.path.stem in LONGEST else len(LONGEST))


@pytest.fixture(autouse=True)
def interrupt_handler():
    """What handles SIGINT is after a test what it was before: a node that a test runs in its own process leaves one that ignores the first."""
    before = signal.getsignal(signal.SIGINT)
    yield
    signal.signal(signal.SIGINT, before)


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


@pytest.fixture(scope="session", autouse=True)
def shared(tmp_path_factory):
    """The folder that all workers of a run have in common."""
    base = tmp_path_factory.getbasetemp()
    os.environ["NP_TESTS_SHARED"] = str(base.parent if "PYTEST_XDIST_WORKER" in os.environ else base)


@pytest.fixture(scope="session")
def untrained(tmp_path_factory):
    """A folder with untrained weights of every network of the card graph."""
    from random_weights import write_weights

    return write_weights(tmp_path_factory.mktemp("weights"))
