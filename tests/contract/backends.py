"""The backends that the contract suite judges, each started anew for every check.

To have another backend judged in the tests, add it to BACKENDS; `check_backend` puts the same checks to one that is
running (np_evaluation.conformance)."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from np_evaluation.conformance import harness
from np_evaluation.conformance.commands import EFFORTS, PERIOD, TARGETS, BackendCommands, pushing, stay
from np_evaluation.conformance.harness import silent

sys.path.insert(0, str(Path(__file__).parents[1] / "driver"))

import simulated_robot  # noqa: E402

from np_physx_bridge import library  # noqa: E402

__all__ = ["BACKENDS", "PERIOD", "Harness", "pushing", "silent", "stay"]


@contextmanager
def nothing() -> Iterator[dict]:
    """What a backend needs that brings everything itself."""
    yield {}


@contextmanager
def robot() -> Iterator[dict]:
    """A robot for a driver, simulated behind its network protocol."""
    with simulated_robot.simulated_robot() as (_, parameters):
        yield parameters


@dataclass(frozen=True)
class Backend:
    """One backend: its executable, the parameters of each mode, what it can do besides moving the arm.

    commands: what moves it; has_tasks: it draws tasks; has_camera: it gives images; can_pause: its time can
    stand still. needs: what must run before it, giving further parameters. missing: why it cannot be started
    here, or empty."""

    package: str
    name: str
    modes: dict[str, dict] = field(default_factory=dict)
    commands: BackendCommands = EFFORTS
    has_tasks: bool = False
    has_camera: bool = False
    can_pause: bool = False
    needs: Callable[[], AbstractContextManager[dict]] = nothing
    missing: str = ""


BACKENDS = {
    "sim_bridge": Backend(
        "np_sim_bridge",
        "sim_bridge",
        has_tasks=True,
        has_camera=True,
        can_pause=True,
        modes={
            "lockstep": {"mode": "lockstep", "tick_barrier": False, "camera": False},
            "realtime": {"mode": "realtime", "camera": False},
        },
    ),
    "physx_bridge": Backend(
        "np_physx_bridge",
        "physx_bridge",
        has_tasks=True,
        has_camera=True,
        can_pause=True,
        modes={
            "lockstep": {"mode": "lockstep", "tick_barrier": False, "camera": False},
            "realtime": {"mode": "realtime", "camera": False},
        },
        missing=library.missing(),
    ),
    "minimal_backend": Backend("examples", "minimal_backend", modes={"realtime": {}}),
    "franka_driver": Backend(
        "np_franka", "franka_driver", modes={"realtime": {}}, needs=robot, missing=simulated_robot.missing()
    ),
    "franka_driver_onboard": Backend(
        "np_franka",
        "franka_driver",
        modes={"realtime": {"control": "onboard"}},
        commands=TARGETS,
        needs=robot,
        missing=simulated_robot.missing(),
    ),
}


class Harness(harness.Harness):
    """A backend as a process of `graph`, in one of its modes, with the test as its controller."""

    def __init__(self, graph, probe, backend: Backend, mode: str, **parameters):
        self.graph, self.probe = graph, probe
        super().__init__(probe, backend)
        graph.run(backend.package, backend.name, {**backend.modes[mode], **parameters})
        self.meet()
