"""Brings the faults of a plan about, and ends them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from std_srvs.srv import SetBool

from np_evaluation.simtest.endpoints import Weather
from np_evaluation.simtest.faults import Freezer, InjectedFault, breaker
from np_evaluation.simtest.graph import SimulatedGraph
from np_evaluation.simtest.scheduler import SECOND

# ns after a push, a wrong sensor or a wrong sight in which what depends on them settles: a held arm is drawn back with 30 N at most, and
# is at rest 0.6 s after a push that has moved it by 0.1 rad.
_AFTERWARDS = SECOND
_PUSH = np.array([1.0, 1.0, 0.5, 0.5, 0.2, 0.2, 0.1])  # Nm on each joint, for a size of 1


class Injection:
    """The faults of a run."""

    def __init__(self, run: SimulatedGraph):
        self._run = run
        self.ends = 0.0
        """s at which the last one is over, from `schedule` on."""

    def schedule(self) -> None:
        """Let each begin at its time from now on."""
        self.ends = self._run.seconds + max((f.at + f.seconds for f in self._run.plan.faults), default=0.0)
        for fault in self._run.plan.faults:
            self._run.scheduler.after(round(fault.at * SECOND), lambda fault=fault: self._begin(fault))

    def _begin(self, fault: InjectedFault) -> None:
        run = self._run
        run.log(f"FAULT {fault}")
        end = run.scheduler.now + round(fault.seconds * SECOND)
        process, watch = run.processes.get(fault.target), run.invariants
        match fault.kind:
            case "late_start":
                run.scheduler.at(end, lambda: run.start(fault.target))
            case "crash" | "crash_recorder" | "stop":
                run.end(fault.target, killed=fault.kind != "stop")
                run.scheduler.at(end, lambda: run.start(fault.target))
            case "freeze" if process is not None:
                process.freeze()
                run.scheduler.at(end, process.thaw)
            case "clock_jump":
                run.scheduler.wall_offset += round(fault.size * SECOND)
                for each in run.processes.values():
                    each.wake()  # what timers of this clock wait for may be due
            case "sensor_nan" | "sensor_jump":
                run.disturbance.sensor, watch.sensor_bad_until = _sensor(fault), end + _AFTERWARDS
                run.scheduler.at(end, lambda: setattr(run.disturbance, "sensor", None))
            case "push":
                run.disturbance.torque, watch.pushed_until = fault.size * _PUSH, end + _AFTERWARDS
                run.scheduler.at(end, lambda: setattr(run.disturbance, "torque", 0 * _PUSH))
            case "request":
                watch.recover_asked += fault.target == "sim_bridge/recover"
                run.ask(fault.target, lambda response: None)
            case "pause":
                run.ask("sim_bridge/pause", lambda response: None, SetBool.Request(data=True))
                run.scheduler.at(
                    end, lambda: run.ask("sim_bridge/pause", lambda response: None, SetBool.Request(data=False))
                )
            case "disk_full":
                run.disk.room = int(fault.size)
            case "delay" | "loss" | "duplicates" | "silent_camera" | "frozen_camera" | "nan" | "wrong":
                if fault.target in ("keypoints", "object_pose"):
                    watch.sight_bad_until = end + _AFTERWARDS
                weather = run.network.weather[f"/{fault.target}"] = _weather(fault)
                run.scheduler.at(end, lambda: self._clear(f"/{fault.target}", weather))

    def _clear(self, topic: str, weather: Weather) -> None:
        if self._run.network.weather.get(topic) is weather:
            del self._run.network.weather[topic]


def _sensor(fault: InjectedFault) -> Callable[[np.ndarray], None]:
    def spoil(position: np.ndarray) -> None:
        position[3] = float("nan") if fault.kind == "sensor_nan" else position[3] + fault.size

    return spoil


def _weather(fault: InjectedFault) -> Weather:
    match fault.kind:
        case "delay":
            return Weather(delay=round(fault.size * SECOND))
        case "loss":
            return Weather(loss=fault.size)
        case "duplicates":
            return Weather(duplicates=fault.size)
        case "silent_camera":
            return Weather(is_silent=True)
        case "frozen_camera":
            return Weather(change=Freezer())
    return Weather(change=breaker(fault.target, fault.kind, fault.size), is_refusable=fault.kind == "nan")
