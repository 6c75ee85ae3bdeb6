"""Nodes as processes that are forked from one which has imported what they import: a fork in place of one to five seconds of imports.

A node is otherwise as its installed script starts it: its own process, session, environment and arguments.
"""

from __future__ import annotations

import gc
import importlib
import multiprocessing
import os
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from multiprocessing import forkserver
from typing import TextIO

FORKED = (
    "np_bringup.nodes.goal_node",
    "np_bringup.nodes.robot_state_node",
    "np_control.nodes.joint_impedance_node",
    "np_perception.nodes.keypoint_detector_node",
    "np_policy.nodes.approach_node",
    "np_policy.nodes.episode_node",
    "np_policy.nodes.post_contact_node",
    "np_policy.nodes.pre_contact_node",
    "np_record.nodes.recorder_node",
    "np_sim_bridge.nodes.keypoint_oracle_node",
    "np_sim_bridge.nodes.sim_bridge_node",
)
"""The modules of nodes that are forked; others start as they are installed."""

_FORKS = multiprocessing.get_context("forkserver")
_FORKS.set_forkserver_preload(["np_policy.torch_network", *FORKED])


class ForkedNode:
    """A forked node, with what a supervisor asks of a subprocess.Popen. prepare: is called in it first, with its parent's process id."""

    def __init__(
        self,
        module: str,
        arguments: Sequence[str],
        log: TextIO,
        environment: Mapping[str, str],
        prepare: Callable[[int], None],
    ):
        self._process = _FORKS.Process(
            target=_run, args=(module, list(arguments), log.name, dict(environment), prepare)
        )
        self._process.start()
        self.pid = self._process.pid

    @property
    def returncode(self) -> int | None:
        """As of a Popen: -N where signal N ended it, None while it runs."""
        return self._process.exitcode

    def poll(self) -> int | None:
        """The exit status; None while it runs."""
        return self._process.exitcode

    def wait(self, timeout: float | None = None) -> int:
        """The exit status, once it has ended. Raises subprocess.TimeoutExpired."""
        self._process.join(timeout)
        if self._process.exitcode is None:
            raise subprocess.TimeoutExpired(self._process.name, timeout)
        return self._process.exitcode

    def send_signal(self, number: int) -> None:
        """Nothing where it has ended."""
        if self.poll() is None:
            os.kill(self.pid, number)


def _run(module, arguments, log, environment, prepare) -> None:
    os.close(forkserver._forkserver._forkserver_alive_fd)  # or the process that forks would outlive the tests
    os.setsid()
    with open(log, "a") as file:
        for stream in (sys.stdout, sys.stderr):
            os.dup2(file.fileno(), stream.fileno())
            stream.reconfigure(line_buffering=True)
    prepare(os.getppid())
    os.environ.clear()
    os.environ.update(environment)
    sys.argv = [module, *arguments]
    status = importlib.import_module(module).main()
    gc.collect()  # as at the end of an interpreter, which a fork has none of: a node that could not start leaves the graph
    sys.exit(status)
