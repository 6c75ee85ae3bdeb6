"""Measures the loops of a graph from outside: from a state's publication to the arrival of its command, and from
an image's publication to the arrival of its keypoints.

Times are the middleware's stamps: publication of a state, arrival of a command at this node, which is when it
arrives at the backend too. The time that this node takes afterwards does not count.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from rclpy.node import Node
from sensor_msgs.msg import CameraInfo, JointState, PointCloud2
from std_srvs.srv import Trigger

from np_record.cdr import header_stamp
from np_ros import qos
from np_ros.node import Diagnostics, parameter, run


class RoundTrip(Node):
    """Collects from `~/start` until it is ended, then writes JSON: periods, p50, p99, max in ms, missed; of the
    camera: frames, frame_rate, those without keypoints (frames_dropped), and from image to keypoints
    frame_p50_ms, frame_p99_ms.

    missed: share of the states whose command came after the deadline, or never. An image counts from its
    camera_info, which is published before it.
    """

    def __init__(self):
        super().__init__("round_trip")
        self._out = Path(parameter(self, "out", "round_trip.json", "File for the result."))
        self._deadline = parameter(
            self, "deadline", 0.002, "Time in which the command for a state must arrive, s.", 1e-4, 1.0
        )
        self._diagnostics = Diagnostics(self)
        self._forget()
        self.create_service(Trigger, "~/start", self._on_start)
        self.create_subscription(JointState, "joint_states", self._on_state, qos.RECORDER, raw=True)
        self.create_subscription(JointState, "effort_command", self._on_command, qos.RECORDER, raw=True)
        self.create_subscription(CameraInfo, "camera/camera_info", self._on_frame, qos.RECORDER, raw=True)
        self.create_subscription(PointCloud2, "keypoints", self._on_keypoints, qos.RECORDER, raw=True)

    def _forget(self) -> None:
        self._sent: dict[int, int] = {}
        self._arrived: dict[int, int] = {}
        self._numbers: list[int] = []
        self._frames: dict[int, int] = {}
        self._seen: dict[int, int] = {}

    def _on_start(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._forget()
        response.success = True
        return response

    def destroy_node(self) -> None:
        """Write the result."""
        self._out.write_text(json.dumps(self._result()))
        super().destroy_node()

    def _on_state(self, data: bytes, info: dict) -> None:
        self._sent.setdefault(header_stamp(data), info["source_timestamp"])

    def _on_command(self, data: bytes, info: dict) -> None:
        self._arrived.setdefault(header_stamp(data), info["received_timestamp"])
        self._numbers.append(info["publication_sequence_number"])

    def _on_frame(self, data: bytes, info: dict) -> None:
        self._frames.setdefault(header_stamp(data), info["source_timestamp"])
        self._diagnostics.values["frames"] = len(self._frames)

    def _on_keypoints(self, data: bytes, info: dict) -> None:
        self._seen.setdefault(header_stamp(data), info["received_timestamp"])
        self._diagnostics.values["keypoints"] = len(self._seen)

    def _result(self) -> dict[str, object]:
        return self._control() | self._camera()

    def _camera(self) -> dict[str, object]:
        stamps = sorted(self._frames)[:-3]  # the last ones may still be on their way
        if len(stamps) < 2:
            return {"frames": len(stamps), "frames_dropped": 0}
        took = [(self._seen[s] - self._frames[s]) * 1e-6 for s in stamps if s in self._seen]
        p50, p99 = np.percentile(took, (50, 99)) if took else (np.inf, np.inf)
        elapsed = (self._frames[stamps[-1]] - self._frames[stamps[0]]) * 1e-9
        return {
            "frames": len(stamps),
            "frame_rate": round((len(stamps) - 1) / elapsed, 1),
            "frames_dropped": len(stamps) - len(took),
            "frame_p50_ms": round(float(p50), 1),
            "frame_p99_ms": round(float(p99), 1),
        }

    def _control(self) -> dict[str, object]:
        stamps = sorted(self._sent)[:-10]  # the last ones may still be on their way
        if not stamps or not self._arrived:
            return {"periods": len(stamps), "answered": 0}
        first = min(self._arrived)
        stamps = [s for s in stamps if s >= first]
        milliseconds = np.array([(self._arrived[s] - self._sent[s]) * 1e-6 for s in stamps if s in self._arrived])
        unheard = max(self._numbers) - min(self._numbers) + 1 - len(set(self._numbers))  # lost on the way to here only
        unanswered = max(0, len(stamps) - len(milliseconds) - unheard)
        late = int((milliseconds > 1e3 * self._deadline).sum())
        elapsed = (max(self._sent.values()) - min(self._sent.values())) * 1e-9
        p50, p99 = np.percentile(milliseconds, (50, 99))
        return {
            "periods": len(stamps),
            "p50_ms": round(float(p50), 3),
            "p99_ms": round(float(p99), 3),
            "max_ms": round(float(milliseconds.max()), 3),
            "missed": round((late + unanswered) / len(stamps), 5),
            "late": late,
            "unanswered": unanswered,
            "state_rate": round(len(stamps) / elapsed, 1),
            "keypoint_rate": round(len(self._seen) / elapsed, 1),
            "seconds": round(elapsed, 1),
        }


def main(args=None):
    """Run the node until SIGINT or SIGTERM."""
    return run(RoundTrip, args)


if __name__ == "__main__":
    raise SystemExit(main())
