"""One node of the graph as an operating-system process: in a run over DDS it replaces `np_evaluation.simtest.process.Process`."""

from __future__ import annotations

import os
import signal
from collections import Counter
from collections.abc import Callable, Mapping
from types import SimpleNamespace

from np_evaluation.simtest.scheduler import SECOND, Scheduler
from np_ros.processes.graph import NodeSpec
from np_ros.processes.supervisor import Supervisor

_POLL_PERIOD = SECOND // 200  # ns between two checks for a service and its response


class DdsProcess:
    """One process of a node from start to end; a restart makes another DdsProcess.

    died: why it ended without a request, "" if it did not. node.diagnostics.counts: refusals that it has published since `reset_counts`.
    has_published: whether it has published diagnostics.
    """

    def __init__(self, supervisor: Supervisor, spec: NodeSpec, scheduler: Scheduler, clients: dict):
        self._supervisor, self._scheduler, self._clients = supervisor, scheduler, clients
        self._name = spec.name
        self.node = SimpleNamespace(diagnostics=SimpleNamespace(counts=Counter()))
        self.is_alive, self.died, self.has_published = True, "", False
        self._counts_at_reset = Counter()
        supervisor.start(spec)
        self._pid = supervisor.pid(spec.name)

    def on_diagnostics(self, values: Mapping[str, str]) -> None:
        """Store the values of the node's diagnostics."""
        self.has_published = True
        counts = Counter({key: int(value) for key, value in values.items() if key.startswith("refused_")})
        self.node.diagnostics.counts = counts - self._counts_at_reset

    def reset_counts(self) -> None:
        """Set all counts to zero."""
        self._counts_at_reset += self.node.diagnostics.counts
        self.node.diagnostics.counts = Counter()

    def freeze(self) -> None:
        """Suspend it with SIGSTOP."""
        self._send(signal.SIGSTOP)

    def thaw(self) -> None:
        """Resume it with SIGCONT."""
        self._send(signal.SIGCONT)

    def kill(self) -> None:
        """End it with SIGKILL."""
        self.is_alive = False
        self._send(signal.SIGKILL)

    def stop(self) -> None:
        """End it with SIGINT; resume it first if it is frozen."""
        self.is_alive = False
        self.thaw()
        self._send(signal.SIGINT)

    def call(self, service: str, request, on_response: Callable[[object], None]) -> None:
        """Call one of its services as soon as it is ready; `on_response` receives the response."""
        client, futures = self._clients[service], []

        def poll() -> None:
            if not futures and client.service_is_ready():
                futures.append(client.call_async(request))
            if futures and futures[0].done():
                on_response(futures[0].result())
            elif self.is_alive:
                self._scheduler.call_after(_POLL_PERIOD, poll)

        poll()

    def poll(self) -> None:
        """Remove it from the supervisor once it has ended; set `died` if it ended without a request."""
        if self._is_supervised() and self._supervisor.ended(self._name):
            if self.is_alive:
                self.is_alive, self.died = False, " ".join(self._supervisor.last_lines(self._name, 3)) or "no output"
            self._supervisor.stop(self._name)

    def _is_supervised(self) -> bool:
        return self._name in self._supervisor.names and self._supervisor.pid(self._name) == self._pid

    def _send(self, number: signal.Signals) -> None:
        if self._is_supervised() and not self._supervisor.ended(self._name):
            os.kill(self._pid, number)
