"""Starts and ends the faults of a plan."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from std_srvs.srv import SetBool

from np_evaluation.simtest.endpoints import TopicFault
from np_evaluation.simtest.faults import FrozenCamera, InjectedFault, make_corrupter
from np_evaluation.simtest.graph import SimulatedGraph
from np_evaluation.simtest.scheduler import SECOND

# ns from the end of a push, a sensor fault or a keypoint fault until the checks apply again. At most 30 N pull a held arm back: it is at
# rest 0.6 s after a push that moved it by 0.1 rad.
_SETTLING = SECOND
_PUSH = np.array([1.0, 1.0, 0.5, 0.5, 0.2, 0.2, 0.1])  # Nm on each joint at size 1


class Injection:
    """The faults of a run."""

    def __init__(self, run: SimulatedGraph):
        self._run = run
        self.ends = 0.0
        """s of the run at which the last fault ends; set by `schedule`."""

    def schedule(self) -> None:
        """Schedule every fault at its time, counted from now."""
        self.ends = self._run.seconds + max((f.at + f.seconds for f in self._run.plan.faults), default=0.0)
        for fault in self._run.plan.faults:
            self._run.scheduler.call_after(round(fault.at * SECOND), lambda fault=fault: self._begin(fault))

    def _begin(self, fault: InjectedFault) -> None:
        run = self._run
        run.log(f"FAULT {fault}")
        end = run.scheduler.now + round(fault.seconds * SECOND)
        process, watch = run.processes.get(fault.target), run.invariants
        match fault.kind:
            case "late_start":
                run.scheduler.call_at(end, lambda: run.start(fault.target))
            case "crash" | "crash_recorder" | "stop":
                run.end(fault.target, killed=fault.kind != "stop")
                run.scheduler.call_at(end, lambda: run.start(fault.target))
            case "freeze" if process is not None:
                process.freeze()
                run.scheduler.call_at(end, process.thaw)
            case "clock_jump":
                run.scheduler.wall_offset += round(fault.size * SECOND)
                for each in run.processes.values():
                    each.wake()  # timers of this clock may be due
            case "sensor_nan" | "sensor_jump":
                run.disturbance.sensor, watch.sensor_bad_until = _make_sensor_fault(fault), end + _SETTLING
                run.scheduler.call_at(end, lambda: setattr(run.disturbance, "sensor", None))
            case "push":
                run.disturbance.torque, watch.pushed_until = fault.size * _PUSH, end + _SETTLING
                run.scheduler.call_at(end, lambda: setattr(run.disturbance, "torque", 0 * _PUSH))
            case "request":
                watch.recover_requests += fault.target == "sim_bridge/recover"
                run.call(fault.target, lambda response: None)
            case "pause":
                run.call("sim_bridge/pause", lambda response: None, SetBool.Request(data=True))
                run.scheduler.call_at(
                    end, lambda: run.call("sim_bridge/pause", lambda response: None, SetBool.Request(data=False))
                )
            case "disk_full":
                run.disk.room = int(fault.size)
            case "delay" | "loss" | "duplicates" | "silent_camera" | "frozen_camera" | "nan" | "wrong":
                if fault.target in ("keypoints", "object_pose"):
                    watch.keypoints_bad_until = end + _SETTLING
                topic_fault = run.network.topic_faults[f"/{fault.target}"] = _make_topic_fault(fault)
                run.scheduler.call_at(end, lambda: self._clear(f"/{fault.target}", topic_fault))

    def _clear(self, topic: str, topic_fault: TopicFault) -> None:
        if self._run.network.topic_faults.get(topic) is topic_fault:
            del self._run.network.topic_faults[topic]


def _make_sensor_fault(fault: InjectedFault) -> Callable[[np.ndarray], None]:
    def corrupt(position: np.ndarray) -> None:
        position[3] = float("nan") if fault.kind == "sensor_nan" else position[3] + fault.size

    return corrupt


def _make_topic_fault(fault: InjectedFault) -> TopicFault:
    match fault.kind:
        case "delay":
            return TopicFault(delay=round(fault.size * SECOND))
        case "loss":
            return TopicFault(loss=fault.size)
        case "duplicates":
            return TopicFault(duplicates=fault.size)
        case "silent_camera":
            return TopicFault(is_silent=True)
        case "frozen_camera":
            return TopicFault(change=FrozenCamera())
    return TopicFault(change=make_corrupter(fault.target, fault.kind, fault.size), is_invalid=fault.kind == "nan")
