"""One node of the graph as a process of the machine: for a run over DDS what `np_evaluation.simtest.process.Process` is for a simulated one."""

from __future__ import annotations

import os
import signal
from collections import Counter
from collections.abc import Callable, Mapping
from types import SimpleNamespace

from np_evaluation.simtest.scheduler import SECOND, Scheduler
from np_ros.processes.graph import NodeSpec
from np_ros.processes.supervisor import Supervisor

_AGAIN = SECOND // 200  # ns between two looks for a service and its answer


class DdsProcess:
    """A node from its start to its end; started anew it is another DdsProcess. `died` says of what it ended by itself.

    node.diagnostics.counts: what it has refused since `forget_counts`, as far as it has said so. has_spoken: whether it has said anything.
    """

    def __init__(self, supervisor: Supervisor, spec: NodeSpec, scheduler: Scheduler, clients: dict):
        self._supervisor, self._scheduler, self._clients = supervisor, scheduler, clients
        self._name = spec.name
        self.node = SimpleNamespace(diagnostics=SimpleNamespace(counts=Counter()))
        self.is_alive, self.died, self.has_spoken = True, "", False
        self._forgotten = Counter()
        supervisor.start(spec)
        self._pid = supervisor.pid(spec.name)

    def on_diagnostics(self, said: Mapping[str, str]) -> None:
        """It has said this of itself."""
        self.has_spoken = True
        counts = Counter({key: int(value) for key, value in said.items() if key.startswith("refused_")})
        self.node.diagnostics.counts = counts - self._forgotten

    def forget_counts(self) -> None:
        """Count anew."""
        self._forgotten += self.node.diagnostics.counts
        self.node.diagnostics.counts = Counter()

    def freeze(self) -> None:
        """Stop it."""
        self._send(signal.SIGSTOP)

    def thaw(self) -> None:
        """Let it go on."""
        self._send(signal.SIGCONT)

    def kill(self) -> None:
        """End it without its doing."""
        self.is_alive = False
        self._send(signal.SIGKILL)

    def stop(self) -> None:
        """Ask it to end, frozen or not."""
        self.is_alive = False
        self.thaw()
        self._send(signal.SIGINT)

    def call(self, service: str, request, answer: Callable[[object], None]) -> None:
        """Ask one of its services as soon as it is there; `answer` is given the response."""
        client, asked = self._clients[service], []

        def look() -> None:
            if not asked and client.service_is_ready():
                asked.append(client.call_async(request))
            if asked and asked[0].done():
                answer(asked[0].result())
            elif self.is_alive:
                self._scheduler.after(_AGAIN, look)

        look()

    def look(self) -> None:
        """Let the supervisor forget it once it has ended; `died` then says why, where nobody has ended it."""
        if self._is_known() and self._supervisor.ended(self._name):
            if self.is_alive:
                self.is_alive, self.died = False, " ".join(self._supervisor.last_lines(self._name, 3)) or "no word"
            self._supervisor.stop(self._name)

    def _is_known(self) -> bool:
        return self._name in self._supervisor.names and self._supervisor.pid(self._name) == self._pid

    def _send(self, number: signal.Signals) -> None:
        if self._is_known() and not self._supervisor.ended(self._name):
            os.kill(self._pid, number)
