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
    """`any_start` runs a test in every mode of every backend; `lockstep_start`, `realtime_start` in that mode."""
    for fixture, chosen in (("any_start", PAIRS), ("lockstep_start", [p for p in PAIRS if p[1] == "lockstep"]),
                            ("realtime_start", [p for p in PAIRS if p[1] == "realtime"])):
        if fixture in metafunc.fixturenames:
            metafunc.parametrize(fixture, chosen, ids=["-".join(p) for p in chosen], indirect=True)


@pytest.fixture
def any_start(request, tmp_path):
    """A function that starts the backend, alone in its ROS domain, with parameters by keyword, and gives a Harness."""
    name, mode = request.param
    with ExitStack() as stack:
        def start(**parameters) -> Harness:
            graph = stack.enter_context(Graph(tmp_path / f"log{len(list(tmp_path.iterdir()))}"))
            probe = stack.enter_context(closing(Probe(graph)))
            return Harness(graph, probe, BACKENDS[name], mode, **parameters)
        yield start


lockstep_start = realtime_start = any_start
