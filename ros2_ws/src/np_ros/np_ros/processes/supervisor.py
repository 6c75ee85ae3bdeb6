"""Nodes as separate processes: start, watch, stop, and report which one died and why.

The part of `ros2 launch` that the demo, the evaluation and the tests need, so that it also works where
launch is not installed. A node is found as `ros2 run` finds it: the ament index, then
lib/<package>/<executable>.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from importlib.resources import files
from pathlib import Path
from typing import TextIO

import yaml

from np_common.parent_process import end_with_parent
from np_ros.processes.domain import ros_domain_id
from np_ros.processes.graph import NodeSpec
from np_ros.processes.locks import lock

STOP_SEQUENCE = ((signal.SIGINT, 8.0), (signal.SIGTERM, 3.0), (signal.SIGKILL, 3.0))
"""What a process gets, and how long s it may take, until it has ended."""

_ENDED = 60.0  # s in which a process ends that was killed, which may have a bag to close; only how long until a broken one is reported
_LAST_LINES = 12
# MuJoCo, imported, looks for a library of windows in a process of its own, a tenth of a second in each node; none opens one.
_UNASKED = {"MUJOCO_GL": "disable"}


class NodeDied(RuntimeError):
    """A node ended by itself. `name` is the node's, `returncode` its process's."""

    def __init__(self, name: str, returncode: int, last_lines: Sequence[str]):
        super().__init__(name, returncode, last_lines)
        self.name, self.returncode = name, returncode

    def __str__(self) -> str:
        name, code, last_lines = self.args
        how = f"signal {signal.Signals(-code).name}" if code < 0 else f"status {code}"
        tail = "".join(f"\n  {line}" for line in last_lines) or " (it printed nothing)"
        return f"node {name} ended with {how}; its last lines:{tail}"


def find_installed_command(package: str, executable: str) -> list[str]:
    """The command of an installed executable, or of a module of the package. Raises LookupError with the folders searched."""
    if executable.startswith(f"{package}."):
        return [sys.executable, "-m", executable]
    prefixes = [Path(p) for p in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if p]
    for prefix in prefixes:
        path = prefix / "lib" / package / executable
        if (prefix / "share/ament_index/resource_index/packages" / package).exists() and os.access(path, os.X_OK):
            return [str(path)]
    raise LookupError(
        f"expected an installed executable {package}/{executable} below AMENT_PREFIX_PATH, found none in "
        f"{[str(p) for p in prefixes]}; build and source the workspace first"
    )


def reserve_domain_id(folder: Path | None = None) -> tuple[int, TextIO]:
    """A ROS domain id no other supervisor of this machine uses, and the open file that reserves it.

    folder: where the files are that stand for the ids, the system's temporary one unless given; users who have it in
    common exclude each other. Raises RuntimeError when all are taken.
    """
    folder = folder or Path(tempfile.gettempdir())
    for domain_id in range(1, 102):  # the range whose ports are free of Linux's ephemeral ones
        try:
            handle = lock(folder / f"np_ros_domain_{domain_id}.lock")
        except OSError:
            continue  # not ours to open: whose it is may use the id
        if handle is not None:
            return domain_id, handle
    raise RuntimeError(f"no free ROS domain id: expected one of 1..101 without a lock in {folder}, all are in use")


class Supervisor:
    """Owns the processes of a graph, in a ROS domain of its own on this machine.

    with Supervisor("runs/log") as supervisor:
        supervisor.start(task_graph({...}))
        supervisor.wait(lambda: ..., timeout=30, what="the phase")

    log_directory: each node's output goes to <log_directory>/<name>.log, its parameters to <name>.yaml.
    domain_id: a free one is reserved unless given. locate: how an executable becomes a command. Raises ValueError where the
    shell's ROS_DOMAIN_ID is none.
    """

    def __init__(
        self,
        log_directory: str | Path,
        *,
        domain_id: int | None = None,
        locate: Callable[[str, str], list[str]] = find_installed_command,
    ):
        ros_domain_id()  # a bad one is reported, though a graph in a domain of its own does without it
        self.log_directory = Path(log_directory)
        self.log_directory.mkdir(parents=True, exist_ok=True)
        self._reservation = None
        if domain_id is None:
            domain_id, self._reservation = reserve_domain_id()
        self.domain_id = domain_id
        self._locate = locate
        self._processes: dict[str, subprocess.Popen] = {}

    def __enter__(self) -> Supervisor:
        return self

    def __exit__(self, *exception) -> None:
        self.close()

    @property
    def environment(self) -> dict[str, str]:
        """The variables that put a process into this supervisor's ROS domain."""
        variables = {
            "ROS_DOMAIN_ID": str(self.domain_id),
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
            "PYTHONUNBUFFERED": "1",
        }
        if "FASTRTPS_DEFAULT_PROFILES_FILE" not in os.environ:
            variables["FASTRTPS_DEFAULT_PROFILES_FILE"] = str(files("np_ros") / "data" / "fastdds.xml")
        return variables

    @property
    def names(self) -> list[str]:
        """The nodes started and not stopped, in order of start."""
        return list(self._processes)

    def start(self, specs: NodeSpec | Sequence[NodeSpec], environment: Mapping[str, str] | None = None) -> None:
        """Start nodes. Raises LookupError if one is not installed (none is started then), ValueError for a
        name in use.
        """
        specs = [specs] if isinstance(specs, NodeSpec) else list(specs)
        commands = [self._locate(spec.package, spec.executable) for spec in specs]
        for spec, command in zip(specs, commands):
            if spec.name in self._processes:
                raise ValueError(f"node name {spec.name}: expected a new one, it is running")
            with open(self.log_directory / f"{spec.name}.log", "w") as log:
                self._processes[spec.name] = subprocess.Popen(
                    [*command, *self._ros_arguments(spec)],
                    stdin=subprocess.DEVNULL,
                    stdout=log,
                    stderr=subprocess.STDOUT,
                    env={**_UNASKED, **os.environ, **self.environment, **(environment or {})},
                    # Own session: Ctrl-C in the terminal reaches only us, who stop the nodes in order.
                    # If we are killed outright, the kernel ends the nodes.
                    start_new_session=True,
                    preexec_fn=partial(_prepare, os.getpid(), spec.nice, spec.realtime),
                )

    def pid(self, name: str) -> int:
        """Process id of a running node."""
        return self._processes[name].pid

    def ended(self, name: str) -> bool:
        """Whether the process of a node has ended."""
        return self._processes[name].poll() is not None

    def last_lines(self, name: str, count: int = _LAST_LINES) -> list[str]:
        """The end of what a node has printed."""
        return (self.log_directory / f"{name}.log").read_text(errors="replace").splitlines()[-count:]

    def check(self) -> None:
        """Raise NodeDied if a node has ended by itself."""
        for name, process in self._processes.items():
            if process.poll() is not None:
                raise NodeDied(name, process.returncode, self.last_lines(name))

    def wait(self, condition: Callable[[], bool], timeout: float, what: str) -> None:
        """Wait until `condition()` holds; it is called again and again, so let it block shortly (spin a node).

        Raises NodeDied, or TimeoutError naming `what`, which did not come within `timeout` s.
        """
        deadline = time.monotonic() + timeout
        while not condition():
            try:
                self.check()
            except NodeDied:
                if condition():  # that it ended is what was waited for
                    return
                raise
            if time.monotonic() > deadline:
                raise TimeoutError(f"expected {what} within {timeout:g} s; it did not come")

    def stop(self, *names: str) -> None:
        """End the named nodes (all if none is named), latest started first, and forget them."""
        processes = {name: self._processes[name] for name in reversed(names or self.names)}
        for number, patience in STOP_SEQUENCE:
            for process in processes.values():
                if process.poll() is None:
                    process.send_signal(number)
            deadline = time.monotonic() + patience
            for name, process in list(processes.items()):
                try:
                    process.wait(max(0.0, deadline - time.monotonic()))
                    del self._processes[name], processes[name]
                except subprocess.TimeoutExpired:
                    pass
            if not processes:
                return
        raise RuntimeError(f"processes survive SIGKILL: { {n: p.pid for n, p in processes.items()} }")

    def kill(self, name: str, number: signal.Signals = signal.SIGKILL) -> int:
        """Send a signal that ends a node, wait for that, forget it; its return code. For fault injection."""
        process = self._processes[name]
        process.send_signal(number)
        returncode = process.wait(_ENDED)
        del self._processes[name]
        return returncode

    def close(self) -> None:
        """End every node and give the domain id back."""
        try:
            self.stop()
        finally:
            if self._reservation:
                self._reservation.close()
                self._reservation = None

    def _ros_arguments(self, spec: NodeSpec) -> list[str]:
        arguments = ["--ros-args", "-r", f"__node:={spec.name}"]
        for before, after in spec.remappings:
            arguments += ["-r", f"{before}:={after}"]
        if spec.parameters:
            path = self.log_directory / f"{spec.name}.yaml"
            path.write_text(yaml.safe_dump({"/**": {"ros__parameters": dict(spec.parameters)}}, width=1 << 30))
            arguments += ["--params-file", str(path)]
        if spec.namespace:
            arguments += ["-r", f"__ns:={spec.namespace}"]
        if spec.params_file:
            arguments += ["--params-file", spec.params_file]
        return arguments


def _prepare(parent: int, nice: int, realtime: int) -> None:
    """Set up the new process before it executes the node, so that the middleware's threads inherit it all."""
    end_with_parent()
    if os.getppid() != parent:  # it died before the signal was requested
        os._exit(128 + signal.SIGTERM)
    os.nice(nice)
    if realtime:
        try:
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(realtime))
        except PermissionError:
            print(f"SCHED_FIFO priority {realtime} is not permitted; running without it", flush=True)
