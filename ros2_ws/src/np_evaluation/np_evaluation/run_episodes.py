"""Some episodes of an evaluation through a graph, in this process or in one of its own."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

from np_common.cli import new_folder
from np_description.phases import FAULT
from np_evaluation.results import PartialResults
from np_evaluation.scoring import Result, breakdown, engine_version, result_of
from np_ros.processes.supervisor import NodeDied


class ResultSink(Protocol):
    """A receiver of results."""

    def add(self, result: Result) -> None:
        """One result, which has to be kept at once."""


@dataclass(frozen=True)
class RunRequest:
    """How episodes are run."""

    arguments: Mapping[str, str]
    """Launch arguments, but for the first episode."""
    engine: str
    """mujoco or physx."""
    record: bool
    """Whether bags are recorded."""
    out: Path
    """Folder of the logs."""


def play(
    request: RunRequest,
    numbers: range,
    results: ResultSink,
    on_tick: Callable[[int, float], None] = lambda number, s: None,
) -> None:
    """Run episodes one after the other, and add their results; on_tick is called with an episode's number and its time, s.

    A graph that breaks down costs its episode and is started anew; one that does not come up at all raises NodeDied or TimeoutError.
    """
    from np_evaluation.commands.common import running_graph

    number, stamp = numbers.start, engine_version(request.engine)
    while number < numbers.stop:
        logs = new_folder(request.out / "log")
        arguments = {**request.arguments, "first_episode": str(number)}
        with running_graph(arguments, logs, on_tick=lambda s: on_tick(number, s)) as conductor:
            whole = True
            while whole and number < numbers.stop:
                result, whole = _run_one(conductor, number, request.record)
                results.add(replace(result, engine=request.engine, engine_version=stamp))
                number += 1
        if not whole:
            print(f"episode {number - 1}: {result.reason}\nlogs are in {logs}", file=sys.stderr)


def play_part(request: RunRequest, numbers: range, part: Path) -> None:
    """`play`, with results in a file of its own; goes on where a process that was lost has ended."""
    results = PartialResults(part)
    play(request, numbers[results.done :], results)


def _run_one(conductor, number: int, record: bool) -> tuple[Result, bool]:
    """One episode, and whether the graph is still whole."""
    from np_ros.client.supervised_client import GraphError

    began = time.monotonic()
    try:
        if record:
            conductor.start_recording()
        outcome = conductor.run_episode()
        if record:
            conductor.stop_recording()
    except (NodeDied, GraphError, TimeoutError) as error:
        return breakdown(number, str(error), time.monotonic() - began), False
    return result_of(
        number, outcome, time.monotonic() - began, conductor.depths, conductor.limit_shares, conductor.force
    ), outcome.declared != FAULT
