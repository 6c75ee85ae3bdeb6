"""Fixtures of the contract suite: how to start a backend, in each mode that it has."""

import sys
from contextlib import ExitStack, closing
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from backends import BACKENDS, Harness  # noqa: E402
from graph_tools import Graph, Probe  # noqa: E402

PAIRS = [(name, mode) for name, backend in BACKENDS.items() for mode in backend.modes]
STARTS = {
    "any_start": lambda backend, mode: True,
    "lockstep_start": lambda backend, mode: mode == "lockstep",
    "realtime_start": lambda backend, mode: mode == "realtime",
    "camera_start": lambda backend, mode: mode == "realtime" and backend.has_camera,
    "pausing_start": lambda backend, mode: mode == "realtime" and backend.can_pause,
}
"""Which backend, in which mode, a test with this fixture is run with."""


def pytest_generate_tests(metafunc):
    """A test runs with every pair of backend and mode that its fixture stands for."""
    for fixture, applies in STARTS.items():
        if fixture in metafunc.fixturenames:
            chosen = [
                pytest.param(
                    (name, mode),
                    id=f"{name}-{mode}",
                    marks=pytest.mark.skipif(bool(BACKENDS[name].missing), reason=BACKENDS[name].missing),
                )
                for name, mode in PAIRS
                if applies(BACKENDS[name], mode)
            ]
            metafunc.parametrize(fixture, chosen, indirect=True)


@pytest.fixture
def any_start(request, tmp_path):
    """A function that starts the backend alone in a ROS domain and gives a Harness."""
    name, mode = request.param
    with ExitStack() as stack:

        def start(**parameters) -> Harness:
            needed = stack.enter_context(BACKENDS[name].needs())
            graph = stack.enter_context(Graph(tmp_path / f"log{len(list(tmp_path.iterdir()))}"))
            probe = stack.enter_context(closing(Probe(graph)))
            return Harness(graph, probe, BACKENDS[name], mode, **needed, **parameters)

        yield start


lockstep_start = realtime_start = camera_start = pausing_start = any_start
