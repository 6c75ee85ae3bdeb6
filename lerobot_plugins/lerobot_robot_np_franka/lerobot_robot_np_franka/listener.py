"""The newest message of each topic, kept by a thread."""

from __future__ import annotations

import os
import threading
from functools import partial
from importlib.resources import files

from np_ros import qos
from np_ros.client.graph_client import GraphClient


class Listener:
    """A node in the ROS domain of ROS_DOMAIN_ID; discovery stays on this machine unless the environment sets otherwise."""

    def __init__(self, name: str, topics: dict[str, type], timeout: float) -> None:
        os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        os.environ.setdefault("FASTRTPS_DEFAULT_PROFILES_FILE", str(files("np_ros") / "data" / "fastdds.xml"))
        self.client = GraphClient(name, limit=timeout)
        self._topics, self._newest = topics, {}
        self._closing = threading.Event()
        self._thread: threading.Thread | None = None
        for topic, message_type in topics.items():
            keep = partial(self._newest.__setitem__, topic)
            profile = qos.LATCHED if topic == "goal_keypoints" else qos.REALTIME_SUBSCRIBER
            self.client.node.create_subscription(message_type, topic, keep, profile)

    def start(self) -> None:
        """Wait for the first message of each topic, then receive in a thread. Do all other waiting before this call.

        Raises TimeoutError that names the topics without a publisher.
        """
        self.client.wait_until(
            lambda: self._topics.keys() <= self._newest.keys(),
            what=f"messages on {', '.join(self._topics)} in ROS_DOMAIN_ID {os.environ.get('ROS_DOMAIN_ID', '0')}",
        )
        self._thread = threading.Thread(target=self._spin, daemon=True)
        self._thread.start()

    def newest(self, topic: str):
        """The newest message."""
        return self._newest[topic]

    def close(self) -> None:
        """Leave the graph."""
        self._closing.set()
        if self._thread is not None:
            self._thread.join()
        self.client.close()

    def _spin(self) -> None:
        while not self._closing.is_set():
            self.client.spin_once()
