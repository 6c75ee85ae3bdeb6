"""Records every topic of the contract into rosbag2 bags (MCAP), one for each `~/start` ... `~/stop`."""

from __future__ import annotations

import importlib
import json
import time
from pathlib import Path

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from std_srvs.srv import Trigger

from np_record.bag_writer import BagWriter
from np_record.recorder import Sequencer
from np_record.topics import BY_NAME, TOPICS, Topic
from np_ros import qos
from np_ros.node import Diagnostics, parameter, run
from np_ros.parameters import check_known

_LOOK = 0.2  # s between looks at the writer
_QUIET = 0.3  # s without a message sent before a stop after which all of these are taken to be here: three heartbeats
_PATIENCE = 1.0  # s after which a stop waits no longer, whatever stamps another host's clock gives its messages


class Recorder(Node):
    """Bags are called <bag>_000, <bag>_001, ...; an existing one is never overwritten.

    A bag begun by `~/start` begins with the state of the next reset (the stamp of `goal_pose`). `~/start` fails
    while a topic of `required` has no publisher yet, and its response names the topic. The response of `~/stop`
    is JSON: bag, messages, repeated, lost. SIGINT and SIGTERM close an open bag like `~/stop`. Where a bag cannot
    be written further (a full disk) the node reports it and ends with status 1; the bag is closed with what it has.
    """

    def __init__(self):
        super().__init__("recorder")
        self._path = parameter(self, "bag", "recording", "Path of the bags, without the number.")
        self._information = parameter(self, "run_info", "{}", "JSON object kept in the bag's metadata under run_info.")
        required = parameter(
            self, "required", "", "Topics, separated by commas, without a publisher of which ~/start fails."
        )
        at_once = parameter(self, "record_at_start", True, "Record from the start of the node, without ~/start.")
        images = parameter(self, "record_images", True, "Whether camera/image_raw is recorded.")
        self._required = [name for name in required.split(",") if name]
        self._writer: BagWriter | None = None
        self._sequencer: Sequencer | None = None
        self._diagnostics = Diagnostics(self)
        self._subscriptions_by_topic = {
            topic.name: self.create_subscription(
                find_message_class(topic.type),
                topic.name,
                self._receiver(topic),
                qos.RECORDER_LATCHED if topic.latched else qos.RECORDER,
                raw=True,
            )
            for topic in TOPICS
            if images or topic.name != "camera/image_raw"
        }
        unknown = sorted(set(self._required) - set(self._subscriptions_by_topic))
        if unknown:
            raise ValueError(f"parameter required: expected topics that are recorded, got {', '.join(unknown)}")
        self.create_timer(_LOOK, self._look_after_writer, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self.create_service(Trigger, "~/start", self._on_start)
        self.create_service(Trigger, "~/stop", self._on_stop)
        if at_once:
            check_known(self)  # before a bag is begun; the rest of the node does without it
            self._open(None)

    def destroy_node(self) -> None:
        """Close an open bag, then the node."""
        if self._writer is not None:
            try:
                self.get_logger().info(json.dumps(self._close()))
            except OSError as error:
                self.get_logger().fatal(str(error))
        super().destroy_node()

    def _look_after_writer(self) -> None:
        """Report a failure of the writer also where no further message comes."""
        if self._writer is not None and self._writer.has_failed:
            self._give_up()

    def _give_up(self) -> None:
        """The writer has failed: report it, and end, so that the supervisor detects it at once."""
        writer, self._writer, self._sequencer = self._writer, None, None
        try:
            writer.close()
        except OSError as error:
            self._diagnostics.report(DiagnosticStatus.ERROR, str(error))
            self.get_logger().fatal(str(error))
            self._diagnostics.flush()
        raise SystemExit(1)

    def _receiver(self, topic: Topic):
        many_publishers = topic.name == "diagnostics"

        def receive(data: bytes, info: dict) -> None:
            if self._sequencer is None:
                return
            number = None if many_publishers else info["publication_sequence_number"]
            try:
                self._sequencer.add(topic, data, info["source_timestamp"], number)
            except ValueError as error:
                self._diagnostics.count("malformed messages")
                self.get_logger().error(f"{topic.name}: {error}")
            except OSError:
                self._give_up()

        return receive

    def _open(self, begin_at: Topic | None) -> None:
        number = 0
        while (path := Path(f"{self._path}_{number:03d}")).exists():
            number += 1
        self._writer = BagWriter(path, json.loads(self._information))
        self._sequencer = Sequencer(self._writer.write, begin_at)
        self._diagnostics.report(DiagnosticStatus.OK, f"recording {path}")

    def _close(self) -> dict:
        self._take_what_is_under_way()
        writer, sequencer = self._writer, self._sequencer
        self._writer = self._sequencer = None
        try:
            sequencer.flush()
        finally:
            writer.close()
        return {
            "bag": str(writer.path),
            "messages": writer.count,
            "repeated": sequencer.repeated,
            "lost": sequencer.lost,
        }

    def _take_what_is_under_way(self) -> None:
        """Take what was sent before now. In real time the arm goes on sending: that does not hold up the end."""
        requested, begun = time.time_ns(), time.monotonic()
        received = begun
        while max(time.monotonic() - received - _QUIET, time.monotonic() - begun - _PATIENCE) < 0:
            for subscription in self._subscriptions_by_topic.values():
                while (taken := subscription.handle.take_message(subscription.msg_type, subscription.raw)) is not None:
                    subscription.callback(*taken)
                    if taken[1]["source_timestamp"] <= requested:
                        received = time.monotonic()
            time.sleep(_QUIET / 10)

    def _on_start(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        missing = [name for name in self._required if not self._subscriptions_by_topic[name].get_publisher_count()]
        if self._writer is not None:
            response.message = f"expected no open bag, {self._writer.path} is being recorded"
        elif missing:
            response.message = f"no publisher yet of {', '.join(missing)}"
        else:
            try:
                self._open(BY_NAME["goal_pose"])
                response.success, response.message = True, str(self._writer.path)
            except OSError as error:
                response.message = str(error)
        return response

    def _on_stop(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        if self._writer is None:
            response.message = "expected an open bag, nothing is being recorded"
            return response
        try:
            result = self._close()
            response.success, response.message = True, json.dumps(result)
            self._diagnostics.values.update(result)
            self._diagnostics.report(
                DiagnosticStatus.WARN if result["lost"] else DiagnosticStatus.OK,
                f"closed {result['bag']}, {result['lost']} messages lost",
            )
        except OSError as error:
            response.success, response.message = False, str(error)
            self._diagnostics.report(DiagnosticStatus.ERROR, str(error))
        return response


def find_message_class(message_type: str) -> type:
    """The class of a message type such as sensor_msgs/msg/Image."""
    package, _, name = message_type.split("/")
    return getattr(importlib.import_module(f"{package}.msg"), name)


def main(args=None):
    """Run the node until SIGINT or SIGTERM."""
    return run(Recorder, args)


if __name__ == "__main__":
    raise SystemExit(main())
