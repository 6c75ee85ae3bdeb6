"""Fixtures of the contract suite: how to start a backend, in each mode that it has."""

import sys
from collections.abc import Callable
from contextlib import ExitStack, closing
from functools import partial
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from backends import BACKENDS, Harness  # noqa: E402
from graph_tools import Graph, Probe  # noqa: E402
from simulated_tools import InProcessGraph, InProcessProbe  # noqa: E402

from np_evaluation.conformance.checks import ConformanceCheck  # noqa: E402

PAIRS = [(name, mode) for name, backend in BACKENDS.items() for mode in backend.modes]
STARTS = {
    "running": lambda backend, mode: True,
    "running_realtime": lambda backend, mode: mode == "realtime",
    "lockstep_start": lambda backend, mode: mode == "lockstep",
    "simulated_start": lambda backend, mode: mode == "lockstep",
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
                    marks=[
                        pytest.mark.skipif(bool(BACKENDS[name].missing), reason=BACKENDS[name].missing),
                        *[pytest.mark.real_time] * (mode == "realtime"),
                    ],
                )
                for name, mode in PAIRS
                if applies(BACKENDS[name], mode)
            ]
            scope = "module" if fixture.startswith("running") else None
            metafunc.parametrize(fixture, chosen, indirect=True, scope=scope)


class Running:
    """A backend that is put to one check after another, as `check_backend` does; after one that failed to the next anew.

    start(stack): starts it, with what ends it on the stack.
    """

    def __init__(self, start: Callable[[ExitStack], Harness]):
        self._start, self._stack = start, ExitStack()
        self._harness: Harness | None = None

    def harness(self) -> Harness:
        """The backend for one use; whoever does not give it back leaves a new one to the next."""
        if self._harness is None:
            self.close()
            self._harness = self._start(self._stack)
        harness, self._harness = self._harness, None
        harness.prepare()
        return harness

    def keeps(self, check: ConformanceCheck) -> None:
        """Raises what the check raises."""
        harness = self.harness()
        check.run(harness)
        self._harness = harness

    def close(self) -> None:
        """End the backend."""
        self._stack.close()


def started(name: str, mode: str, folder: Path, stack: ExitStack, **parameters) -> Harness:
    """A backend alone in a ROS domain."""
    needed = stack.enter_context(BACKENDS[name].needs())
    graph = stack.enter_context(Graph(folder / f"log{len(list(folder.iterdir()))}"))
    probe = stack.enter_context(closing(Probe(graph)))
    return Harness(graph, probe, BACKENDS[name], mode, **needed, **parameters)


@pytest.fixture(scope="module")
def running(request, tmp_path_factory):
    """A backend that has been started, for checks."""
    name, mode = request.param
    with closing(Running(partial(started, name, mode, tmp_path_factory.mktemp(name)))) as running:
        yield running


running_realtime = running


@pytest.fixture
def lockstep_start(request, tmp_path):
    """A function that starts the backend alone in a ROS domain and gives a Harness."""
    name, mode = request.param
    with ExitStack() as stack:
        yield partial(started, name, mode, tmp_path, stack)


camera_start = pausing_start = lockstep_start


@pytest.fixture
def simulated_start(request):
    """A function that starts the backend as a simulated process and gives a Harness."""

    def start(**parameters) -> Harness:
        name, mode = request.param
        graph = InProcessGraph()
        return Harness(graph, InProcessProbe(graph), BACKENDS[name], mode, **parameters)

    return start
