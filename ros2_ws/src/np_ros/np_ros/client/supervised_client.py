"""Shared parts of nodes in a command's own process: a context of their own, waiting, calling services.

They run next to the supervisor that owns the other nodes, and spin only while they wait for something.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable

import rclpy
from rclpy.signals import SignalHandlerOptions
from std_srvs.srv import Trigger

from np_ros.client.connection_status import ConnectionStatus
from np_ros.client.interrupts import defer_interrupts
from np_ros.client.services import Services
from np_ros.low_latency.spin import Spinner
from np_ros.processes.supervisor import Supervisor

SERVICE_TIMEOUT = 60.0  # s of wall time
_SPIN = 0.05  # s


class GraphError(RuntimeError):
    """The graph did not do what was requested; the text states what was expected and what came."""


class SupervisedGraphClient:
    """A node in the ROS domain of `supervisor`, whose processes are watched while it waits."""

    def __init__(self, supervisor: Supervisor, name: str):
        self._supervisor = supervisor
        os.environ.update(supervisor.environment)
        self._context = rclpy.Context()
        rclpy.init(
            context=self._context,
            domain_id=supervisor.domain_id,
            signal_handler_options=SignalHandlerOptions.NO,
        )
        self._node = rclpy.create_node(name, context=self._context)
        self._spinner = Spinner(self._node)
        self._links = ConnectionStatus(self._node)
        self._services = Services(self._node, self._wait)

    def __enter__(self):
        return self

    def __exit__(self, *exception) -> None:
        self.close()

    def close(self) -> None:
        """Leave the graph."""
        self._spinner.close()
        self._node.destroy_node()
        rclpy.shutdown(context=self._context)

    def call(self, service: str) -> Trigger.Response:
        """The response of a Trigger service. Raises TimeoutError or NodeDied."""
        return self._services.call(Trigger, service, Trigger.Request(), SERVICE_TIMEOUT)

    def processes(self) -> dict[str, int]:
        """The process of each node of the graph, by name."""
        return {name: self._supervisor.pid(name) for name in self._supervisor.names}

    def find(self, service: str, timeout: float = SERVICE_TIMEOUT) -> None:
        """Wait until a Trigger service is there. Raises TimeoutError or NodeDied."""
        self._services.find(Trigger, service, timeout)

    def stop_recording(self) -> dict:
        """Close the recorder's bag; its response. Raises GraphError with the recorder's reason."""
        return json.loads(self._succeed("recorder/stop").message)

    def _succeed(self, service: str) -> Trigger.Response:
        answer = self.call(service)
        if not answer.success:
            raise GraphError(f"{service}: expected success, got: {answer.message}")
        return answer

    def _wait(self, condition: Callable[[], object], timeout: float, what: str) -> None:
        """Spin until the condition holds. Raises NodeDied, or TimeoutError that names `what`."""

        def spun() -> bool:
            if condition():
                return True
            self._spin_once()
            return bool(condition())

        self._supervisor.wait(spun, timeout, what)

    def _spin_once(self) -> None:
        with defer_interrupts():
            self._spinner.spin_once(_SPIN)
