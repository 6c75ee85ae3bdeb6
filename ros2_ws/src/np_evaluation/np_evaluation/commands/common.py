"""A running graph for commands that need one."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from np_bringup.backends import SIMULATED
from np_bringup.task_graph import check_and_build_graph
from np_description.objects.choice import read_domain
from np_evaluation.nodes.episode_runner_node import EpisodeRunner
from np_ros.processes.supervisor import Supervisor


@contextmanager
def running_graph(arguments: Mapping[str, str], logs: Path, **callbacks) -> Iterator[EpisodeRunner]:
    """The card graph, up and ready, and a conductor for it; every process is ended on the way out.

    callbacks as for Conductor. Raises what Supervisor.start and Conductor.wait_until_ready raise.
    """
    specs = check_and_build_graph(arguments)
    domain = read_domain(arguments)
    lockstep = arguments.get("mode", "lockstep") == "lockstep"
    with Supervisor(logs) as supervisor:
        supervisor.start(specs)
        backend = arguments.get("backend", SIMULATED)
        with EpisodeRunner(supervisor, domain, lockstep=lockstep, backend=backend, **callbacks) as conductor:
            conductor.wait_until_ready(specs)
            yield conductor
