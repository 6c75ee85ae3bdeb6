"""The driver against a simulated robot; skipped, with the reason, where either is not installed."""

import os
import sys
from contextlib import ExitStack, closing
from pathlib import Path

import pytest

for folder in ("driver", "contract"):
    sys.path.insert(0, str(Path(__file__).parents[1] / folder))

from backends import BACKENDS, Harness  # noqa: E402
from graph_tools import Graph, Probe  # noqa: E402
from simulated_robot import missing, simulated_robot  # noqa: E402


def pytest_collection_modifyitems(items):
    """Skip this folder where its tests cannot run."""
    here, reason = Path(__file__).parent, missing()
    for item in items:
        if reason and item.path.is_relative_to(here):
            item.add_marker(pytest.mark.skip(reason=reason))


@pytest.fixture(autouse=True)
def own_priority():
    """libfranka gives the thread that controls a robot the highest priority that there is. Where a test does
    that in this process, it is not to hand it on to all that later tests start."""
    before = os.sched_getscheduler(0), os.sched_getparam(0)
    yield
    os.sched_setscheduler(0, *before)


@pytest.fixture
def start_robot():
    """A function that starts a simulated robot: the robot, and the parameters that lead the driver to it."""
    with ExitStack() as stack:
        yield lambda **arguments: stack.enter_context(simulated_robot(**arguments))


@pytest.fixture(params=("franka_driver", "franka_driver_onboard"), ids=("topic", "onboard"))
def start_driver(request, tmp_path):
    """A function that starts the driver with these parameters, and gives a Harness; in both its modes."""
    with ExitStack() as stack:

        def start(parameters: dict) -> Harness:
            graph = stack.enter_context(Graph(tmp_path / f"log{len(list(tmp_path.iterdir()))}"))
            probe = stack.enter_context(closing(Probe(graph)))
            return Harness(graph, probe, BACKENDS[request.param], "realtime", **parameters)

        yield start
