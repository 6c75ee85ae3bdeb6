"""Fixtures of the contract suite: how to start a backend, in each mode that it has."""

import sys
from contextlib import ExitStack, closing
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from backends import BACKENDS, Harness  # noqa: E402
from graph_tools import Graph, Probe  # noqa: E402

PAIRS = [(name, mode) for name, backend in BACKENDS.items() for mode in backend.modes]


def pytest_generate_tests(metafunc):
    """`any_start` runs a test in every mode of every backend; `lockstep_start`, `realtime_start` in one."""
    for fixture, modes in (("any_start", ("lockstep", "realtime")), ("lockstep_start", ("lockstep",)),
                           ("realtime_start", ("realtime",))):
        if fixture in metafunc.fixturenames:
            chosen = [pair for pair in PAIRS if pair[1] in modes]
            metafunc.parametrize(fixture, chosen, ids=["-".join(p) for p in chosen], indirect=True)


@pytest.fixture
def any_start(request, tmp_path):
    """A function that starts the backend alone in a ROS domain and gives a Harness."""
    name, mode = request.param
    with ExitStack() as stack:
        def start(**parameters) -> Harness:
            graph = stack.enter_context(Graph(tmp_path / f"log{len(list(tmp_path.iterdir()))}"))
            probe = stack.enter_context(closing(Probe(graph)))
            return Harness(graph, probe, BACKENDS[name], mode, **parameters)
        yield start


lockstep_start = realtime_start = any_start
