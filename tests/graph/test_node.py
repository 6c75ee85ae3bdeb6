"""np_ros.node and np_ros.low_latency.spin: every kind of callback runs, both ways of spinning; parameters and diagnostics."""

import os
from pathlib import Path
from types import SimpleNamespace

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.serialization import deserialize_message
from std_msgs.msg import Int64
from std_srvs.srv import Trigger

from np_ros.low_latency.latest_message import LatestMessage
from np_ros.low_latency.spin import Spinner
from np_ros.node import SUBSCRIBERS, Diagnostics, parameter
from np_ros.qos import EVENT, LOCKSTEP

TIMEOUT = 60.0  # s; only how long a broken spinner takes to fail


@pytest.fixture(params=[True, False], ids=["kept wait set", "executor"])
def spun(graph, request, monkeypatch):
    """A node in a context and domain of its own, and the spinner that runs it."""
    for key, value in graph.environment.items():
        monkeypatch.setenv(key, value)
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=graph.domain_id)
    node = Node("spun", context=context)
    spinner = Spinner(node, allow_fast=request.param)
    assert spinner.is_fast == request.param
    yield node, spinner
    spinner.close()
    node.destroy_node()
    rclpy.try_shutdown(context=context)


def spin_until(node, spinner, condition):
    """Spin until the condition holds."""
    clock = node.get_clock()
    start = clock.now().nanoseconds
    while not condition():
        assert clock.now().nanoseconds - start < TIMEOUT * 1e9, "the condition did not come true"
        spinner.spin_once(0.1)


def test_entities_made_while_spinning_are_served(spun):
    node, spinner = spun
    numbers, ticks = [], []
    node.create_subscription(Int64, "numbers", lambda message: numbers.append(message.data), LOCKSTEP)
    publisher = node.create_publisher(Int64, "numbers", LOCKSTEP)
    timer = node.create_timer(0.001, lambda: ticks.append(None))
    spin_until(node, spinner, lambda: len(ticks) >= 3 and publisher.get_subscription_count())
    timer.cancel()
    for number in range(50):
        publisher.publish(Int64(data=number))
    spin_until(node, spinner, lambda: len(numbers) == 50)
    assert numbers == list(range(50))


def test_polling_runs_what_has_come_and_leaves_the_rest(spun):
    node, spinner = spun
    numbers, ticks = [], []
    node.create_subscription(Int64, "numbers", lambda message: numbers.append(message.data), LOCKSTEP)
    publisher = node.create_publisher(Int64, "numbers", LOCKSTEP)
    spin_until(node, spinner, publisher.get_subscription_count)
    node.create_timer(0.001, lambda: ticks.append(None))
    spin_until(node, spinner, lambda: ticks)  # whoever polls knows the timer, too
    for number in range(5):
        publisher.publish(Int64(data=number))
    ticks.clear()
    start = node.get_clock().now().nanoseconds
    while len(numbers) < 5:
        assert node.get_clock().now().nanoseconds - start < TIMEOUT * 1e9, f"only {numbers} came"
        spinner.poll()
    assert numbers == list(range(5))
    if spinner.is_fast:
        assert not ticks
    spin_until(node, spinner, lambda: ticks)


def test_the_newest_message_is_taken_when_it_is_asked_for(spun):
    """However long nobody asks, and however often the node spins meanwhile: one message waits, the last."""
    node, spinner = spun
    heard = []
    newest = LatestMessage(node, Int64, "numbers")
    node.create_subscription(Int64, "numbers", lambda message: heard.append(message.data), LOCKSTEP)
    publisher = node.create_publisher(Int64, "numbers", LOCKSTEP)
    assert newest.take() is None
    spin_until(node, spinner, lambda: publisher.get_subscription_count() == 2)
    for number in range(20):
        publisher.publish(Int64(data=number))
    spin_until(node, spinner, lambda: len(heard) == 20)
    assert deserialize_message(newest.take(), Int64).data == 19
    assert newest.take() is None
    publisher.publish(Int64(data=20))
    spin_until(node, spinner, lambda: len(heard) == 21)
    assert deserialize_message(newest.take(), Int64).data == 20


def test_destroyed_entities_are_left_alone(spun):
    node, spinner = spun
    first, second = [], []

    def once(message):
        first.append(message.data)
        node.destroy_subscription(subscription)

    subscription = node.create_subscription(Int64, "numbers", once, LOCKSTEP)
    node.create_subscription(Int64, "numbers", lambda message: second.append(message.data), LOCKSTEP)
    publisher = node.create_publisher(Int64, "numbers", LOCKSTEP)
    spin_until(node, spinner, lambda: publisher.get_subscription_count() == 2)
    for number in range(5):
        publisher.publish(Int64(data=number))
    spin_until(node, spinner, lambda: len(second) == 5)
    assert first == [0]


def test_callback_may_ask_for_the_publisher(spun):
    node, spinner = spun
    infos = []
    node.create_subscription(Int64, "numbers", lambda message, info: infos.append(info), LOCKSTEP)
    publisher = node.create_publisher(Int64, "numbers", LOCKSTEP)
    spin_until(node, spinner, publisher.get_subscription_count)
    publisher.publish(Int64(data=1))
    spin_until(node, spinner, lambda: infos)
    assert infos[0]["source_timestamp"] > 0


def test_services_and_clients_are_served(spun):
    node, spinner = spun

    def answer(request, response):
        response.success, response.message = True, "done"
        return response

    node.create_service(Trigger, "stop", answer)
    client = node.create_client(Trigger, "stop")
    spin_until(node, spinner, client.service_is_ready)
    future = client.call_async(Trigger.Request())
    spin_until(node, spinner, future.done)
    assert future.result().message == "done"


def test_exceptions_and_shutdown_reach_the_caller(spun):
    node, spinner = spun

    def fail():
        raise RuntimeError("joint 3 is on fire")

    timer = node.create_timer(0.001, fail)
    with pytest.raises(RuntimeError, match="joint 3"):
        spin_until(node, spinner, lambda: False)
    node.destroy_timer(timer)
    node.create_timer(0.001, lambda: rclpy.try_shutdown(context=node.context))
    with pytest.raises(ExternalShutdownException):
        spinner.spin()


def test_another_rclpy_falls_back_to_the_executor(spun, monkeypatch):
    node, _ = spun
    from rclpy.impl.implementation_singleton import rclpy_implementation

    monkeypatch.delattr(rclpy_implementation, "WaitSet")
    spinner = Spinner(node)
    assert not spinner.is_fast
    spinner.close()


def test_parameters_are_described_ranged_and_read_only(spun):
    node, _ = spun
    assert parameter(node, "rate", 30.0, "Images a second.", 1.0, 60.0) == 30.0
    assert parameter(node, "mode", "camera", "Where keypoints come from.", choices=("camera", "truth")) == "camera"
    assert parameter(node, "depth", 3, "Frames.", 1, 5) == 3
    assert parameter(node, "lockstep", True, "Whether time waits.") is True
    descriptor = node.describe_parameter("rate")
    assert descriptor.description == "Images a second."
    assert (descriptor.floating_point_range[0].from_value, descriptor.floating_point_range[0].to_value) == (1.0, 60.0)
    assert node.describe_parameter("depth").integer_range[0].to_value == 5
    assert not node.set_parameters([Parameter("rate", value=10.0)])[0].successful


@pytest.mark.parametrize("given", [20, 20.0])
def test_a_whole_number_will_do_for_a_real_one(graph, given):
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=graph.domain_id)
    node = Node("kind", context=context, parameter_overrides=[Parameter("rate", value=given)])
    try:
        value = parameter(node, "rate", 30.0, "Images a second.", 1.0, 60.0)
        assert (value, type(value)) == (20.0, float)
    finally:
        node.destroy_node()
        rclpy.try_shutdown(context=context)


@pytest.mark.parametrize(
    "override, text",
    [
        (Parameter("rate", value=61.0), "parameter rate: expected float from 1.0 to 60.0, got 61.0"),
        (Parameter("rate", value="fast"), "parameter rate: expected float from 1.0 to 60.0, got 'fast'"),
        (Parameter("mode", value="lidar"), "expected one of \\['camera', 'truth'\\], got 'lidar'"),
    ],
)
def test_parameters_out_of_range_are_refused(graph, override, text):
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=graph.domain_id)
    node = Node("strict", context=context, parameter_overrides=[override])
    try:
        with pytest.raises(ValueError, match=text):
            parameter(node, "rate", 30.0, "Images a second.", 1.0, 60.0)
            parameter(node, "mode", "camera", "Where keypoints come from.", choices=("camera", "truth"))
    finally:
        node.destroy_node()
        rclpy.shutdown(context=context)


def test_diagnostics_say_counts_and_problems(spun):
    node, spinner = spun
    received = []
    node.create_subscription(DiagnosticArray, "diagnostics", lambda m: received.append(m.status[0]), EVENT)
    node.create_subscription(Int64, "numbers", lambda message: None, LOCKSTEP)
    publisher = node.create_publisher(Int64, "numbers", LOCKSTEP)
    spin_until(node, spinner, publisher.get_subscription_count)
    diagnostics = Diagnostics(node, period=0.05)
    diagnostics.values["mode"] = "lockstep"
    spin_until(node, spinner, lambda: received)
    assert (received[-1].level, received[-1].name) == (DiagnosticStatus.OK, "/spun")

    def first(level):
        return next((status for status in received if status.level == level), None)

    diagnostics.count("refused: finite")
    diagnostics.count("refused: finite")
    spin_until(node, spinner, lambda: first(DiagnosticStatus.WARN))
    warned = first(DiagnosticStatus.WARN)
    values = {v.key: v.value for v in warned.values}
    assert float(values.pop("processor_wait_ms")) >= 0.0
    assert values == {
        "mode": "lockstep",
        "refused: finite": "2",
        SUBSCRIBERS: "/numbers=1",
    }
    assert warned.message == "refused: finite"
    received.clear()
    spin_until(node, spinner, lambda: first(DiagnosticStatus.OK))

    diagnostics.report(DiagnosticStatus.ERROR, "no plan")
    spin_until(node, spinner, lambda: first(DiagnosticStatus.ERROR))
    assert first(DiagnosticStatus.ERROR).message == "no plan"


def test_refusals_are_counted_and_logged_ever_less_often(spun, capfd, monkeypatch):
    node, _ = spun
    now = 10.0
    monkeypatch.setattr("np_ros.node.time", SimpleNamespace(monotonic=lambda: now))
    diagnostics = Diagnostics(node)
    diagnostics.refuse("order", "another reason")
    for now in [10.0 + second / 10 for second in range(6000)]:
        diagnostics.refuse("late", f"after {now - 10:.1f} s")
    now += 200.0
    diagnostics.refuse("late", "much later")
    assert diagnostics.counts == {"refused_late": 6001, "refused_order": 1}
    logged = capfd.readouterr().err
    assert "refused: another reason" in logged and "refused: much later" in logged
    assert [s for s in range(600) if f"refused: after {s}." in logged] == [0, 1, 3, 7, 15, 31, *range(63, 600, 60)]


def test_the_middleware_runs_at_the_loops_priority(graph, probe):
    graph.run("np_control", "joint_impedance", {"mode": "realtime", "realtime_priority": 20})
    probe.wait_until_ready({"joint_impedance"})
    pid = graph.pid("joint_impedance")
    policies = {
        task.name: (os.sched_getscheduler(int(task.name)), os.sched_getparam(int(task.name)).sched_priority)
        for task in Path(f"/proc/{pid}/task").iterdir()
        if int(task.name) == pid or (task / "comm").read_text().startswith("dds.")
    }
    assert len(policies) > 1
    assert len(set(policies.values())) == 1, policies  # that of the loop, whatever was permitted


def test_two_nodes_of_one_name_warn(spun):
    node, spinner = spun
    messages = []
    Diagnostics(node, period=0.01)
    node.create_subscription(DiagnosticArray, "diagnostics", messages.append, EVENT)
    spin_until(node, spinner, lambda: messages)
    assert messages[0].status[0].message == "running"
    twin = Node(node.get_name(), context=node.context)
    spin_until(node, spinner, lambda: messages[-1].status[0].level == DiagnosticStatus.WARN)
    assert "another node of this name is in this ROS domain" in messages[-1].status[0].message
    twin.destroy_node()
    spin_until(node, spinner, lambda: messages[-1].status[0].message == "running")
