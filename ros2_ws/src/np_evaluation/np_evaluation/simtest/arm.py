"""The simulated arm of a run: the graph's bridge over an engine that reports every step and can be disturbed."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from np_description.domains import Pose
from np_description.mujoco_engine import MujocoEngine
from np_evaluation.simtest.invariants import Invariants
from np_sim_bridge.nodes.bridge import Bridge


class ArmDisturbance:
    """Disturbances of the arm: external `torque` (7,) Nm; `sensor`, if set, changes the measured joints (9,) rad, m in place."""

    def __init__(self) -> None:
        self.torque = np.zeros(7)
        self.sensor: Callable[[np.ndarray], None] | None = None


class _WatchedEngine(MujocoEngine):
    """The MuJoCo engine with disturbances; it reports every reset and step to `watch`."""

    watch: Invariants
    disturbance: ArmDisturbance

    def reset(self, start: Pose) -> None:
        super().reset(start)
        self.watch.on_reset()

    def joints(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        measured = super().joints()
        if self.disturbance.sensor is not None:
            self.disturbance.sensor(measured[0])
        return measured

    def step(self, torque: np.ndarray, extra: np.ndarray, opening: float) -> None:
        super().step(torque, extra + self.disturbance.torque, opening)
        self.watch.on_step(torque, *super().joints()[:2])


def make_bridge_class(watch: Invariants, disturbance: ArmDisturbance) -> type[Bridge]:
    """Make a class of `sim_bridge` whose engine reports to `watch` and applies `disturbance`."""
    engine = type("Engine", (_WatchedEngine,), {"watch": watch, "disturbance": disturbance})

    class WatchedBridge(Bridge):
        """np_sim_bridge.nodes.sim_bridge_node.SimBridge over the watched engine."""

        def __init__(self):
            watch.on_start()
            super().__init__("sim_bridge", engine)

    return WatchedBridge
