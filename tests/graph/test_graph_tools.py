"""The probe and a node that is a process find each other and exchange messages."""

import sys

from std_msgs.msg import Float64

ECHO = """
import rclpy
from std_msgs.msg import Float64
rclpy.init()
node = rclpy.create_node("echo")
publisher = node.create_publisher(Float64, "answer", 10)
node.create_subscription(Float64, "question", lambda m: publisher.publish(Float64(data=m.data + 1)), 10)
rclpy.spin(node)
"""


def test_a_probe_exchanges_messages_with_a_process(graph, probe, monkeypatch):
    monkeypatch.setattr(graph, "_locate", lambda package, executable: [sys.executable, "-c", ECHO])
    graph.run("none", "echo")
    answers = probe.collect("answer", Float64)
    probe.advertise("question", Float64)
    probe.wait_until(lambda: probe.matched("question") and probe.publishers("answer") == ["echo"])
    # It may not have found us yet, and its first answer be lost.
    probe.wait_until(lambda: answers or probe.publish("question", Float64(data=1.0)))
    assert answers[0].data == 2.0
