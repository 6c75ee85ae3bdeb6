"""Runs the checks on a backend that is running: which kind it is, which checks apply, and which it passes."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

from np_description.message_arrays import BadMessage
from np_evaluation.conformance.checks import ANY, CAMERA, CHECKS, PAUSE, REAL_TIME, ConformanceCheck
from np_evaluation.conformance.commands import EFFORTS, TARGETS
from np_evaluation.conformance.harness import Harness, TestedBackend
from np_ros.client.graph_client import GraphClient


class NotTestable(RuntimeError):
    """No check could be run; the text states what was expected and what came."""


@dataclass(frozen=True)
class CheckResult:
    """The result of one check."""

    check: ConformanceCheck
    """The check."""
    was_asked: bool
    """Whether it applies to the backend."""
    text: str
    """What failed, empty where nothing did; why it does not apply."""
    seconds: float = 0.0
    """Duration."""

    @property
    def mark(self) -> str:
        """Mark in a list of results: FAIL, ok, or - where the check does not apply."""
        return ("FAIL" if self.text else "ok") if self.was_asked else "-"


def inspect_backend(peer: GraphClient, name: str) -> TestedBackend:
    """The backend of this name, by its topics and services. Raises NotTestable."""
    node = peer.node
    try:
        peer.wait_until(lambda: name in node.get_node_names(), what=f"a node {name} in this ROS_DOMAIN_ID")
        peer.wait_until(
            lambda: name in {*peer.subscribers("effort_command"), *peer.subscribers("target_pose")},
            what=f"{name} to subscribe to effort_command, or to target_pose where the controller is on board",
        )
    except TimeoutError as error:
        raise NotTestable(f"{error}; nodes that are there: {', '.join(sorted(node.get_node_names()))}") from None
    is_effort = name in peer.subscribers("effort_command")
    commands = EFFORTS if is_effort else TARGETS
    others = {p for topic in commands.sent for p in peer.publishers(topic)} - {name}
    if others:
        raise NotTestable(f"expected nobody else to command it, got {', '.join(sorted(others))}: end them for this")
    services = {service for service, _ in node.get_service_names_and_types_by_node(name, "/")}
    return TestedBackend(
        name,
        commands,
        has_tasks=f"/{name}/reset" in services,
        has_camera=name in peer.publishers("camera/image_raw"),
        can_pause=f"/{name}/pause" in services,
    )


def judge(peer: GraphClient, name: str, mode: str, on_result: Callable[[CheckResult], None]) -> list[CheckResult]:
    """Run every check that applies, and call on_result with each result as it comes. Raises NotTestable."""
    backend = inspect_backend(peer, name)
    harness = Harness(peer, backend)
    try:
        harness.meet()
    except TimeoutError as error:
        raise NotTestable(str(error)) from None
    is_real_time = mode == "realtime"
    asked = {
        ANY: True,
        REAL_TIME: is_real_time,
        CAMERA: is_real_time and backend.has_camera,
        PAUSE: is_real_time and backend.can_pause,
    }
    verdicts = []
    for check in CHECKS:
        if not asked[check.asked_of]:
            verdict = CheckResult(check, False, f"applies to {check.asked_of} only")
        else:
            began, text = time.monotonic(), ""
            try:
                harness.prepare()
                check.run(harness)
            except (AssertionError, TimeoutError, BadMessage) as error:
                text = str(error)
            verdict = CheckResult(check, True, text, time.monotonic() - began)
        verdicts.append(verdict)
        on_result(verdict)
    _leave(harness)
    return verdicts


def _leave(harness: Harness) -> None:
    """Bring the backend back to ready; where that fails, a check has failed before."""
    try:
        harness.prepare()
    except (AssertionError, TimeoutError):
        pass
