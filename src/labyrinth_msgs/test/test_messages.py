# SPDX-License-Identifier: Apache-2.0
"""Every field of our interfaces tells its unit, and every interface survives the way through DDS."""

import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

MESSAGES = Path(__file__).resolve().parents[1]
FILES = sorted(file for kind in ("msg", "srv", "action") for file in (MESSAGES / kind).glob(f"*.{kind}"))
CONSTANT = re.compile(r"^\w+\s+[A-Z][A-Z0-9_]*\s*=")
UNIT = re.compile(r"#.*\[[^\[\]]+\]\s*$")


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.name)
def test_every_field_tells_its_unit(file: Path) -> None:
    lines = [line for line in file.read_text().splitlines() if line.strip() and not line.startswith(("#", "---"))]
    assert lines
    for line in lines:
        assert "#" in line, f"{file.name}: '{line}' has no comment"
        if not CONSTANT.match(line):
            assert UNIT.search(line), f"{file.name}: '{line}' names no unit; [-] stands for none"


def test_every_interface_file_is_built() -> None:
    built = re.findall(r"^\s+((?:msg|srv|action)/\w+\.\w+)$", (MESSAGES / "CMakeLists.txt").read_text(), re.MULTILINE)
    assert sorted(built) == sorted(str(file.relative_to(MESSAGES)) for file in FILES)


@pytest.fixture(scope="module")
def node(module_domain: int) -> Iterator[Any]:
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    rclpy = pytest.importorskip("rclpy")
    rclpy.init(domain_id=module_domain)
    node = rclpy.create_node("round_trip")
    yield node
    node.destroy_node()
    rclpy.shutdown()


def filled(kind: Any) -> Any:
    """A message with another value in every field than the one it starts with."""
    message = kind()
    for name, type_name in kind.get_fields_and_field_types().items():
        value = getattr(message, name)
        if hasattr(value, "get_fields_and_field_types"):
            setattr(message, name, filled(type(value)))
        elif type_name.startswith("sequence"):
            element = re.match(r"sequence<(\w+)", type_name)
            assert element is not None
            words = element[1] in ("string", "wstring")
            setattr(message, name, ["a", "ö"] if words else [True, False] if element[1] == "boolean" else [1, 2, 3])
        else:
            setattr(message, name, {bool: True, int: 7, float: 0.1, str: "word ö"}[type(value)])
    return message


def kinds() -> list[Any]:
    messages = pytest.importorskip("labyrinth_msgs.msg", reason="the workspace is not sourced")
    return [getattr(messages, file.stem) for file in FILES if file.suffix == ".msg"]


@pytest.mark.realtime
def test_every_message_crosses_dds_unchanged(node: Any) -> None:
    import rclpy

    for kind in kinds():
        heard: list[Any] = []
        topic = f"/round_trip/{kind.__name__}"
        subscription = node.create_subscription(kind, topic, heard.append, 10)
        publisher = node.create_publisher(kind, topic, 10)
        sent = filled(kind)
        while publisher.get_subscription_count() == 0:
            rclpy.spin_once(node, timeout_sec=0.05)
        publisher.publish(sent)
        while not heard:
            rclpy.spin_once(node, timeout_sec=0.05)
        assert heard == [sent]
        assert heard[0] != kind()
        node.destroy_subscription(subscription)
        node.destroy_publisher(publisher)


@pytest.mark.realtime
def test_services_and_the_actions_cross_dds_unchanged(node: Any) -> None:
    import rclpy
    from rclpy.action import ActionClient, ActionServer

    from labyrinth_msgs import action, srv

    for name in sorted(file.stem for file in FILES if file.suffix == ".srv"):
        kind = getattr(srv, name)
        asked: list[Any] = []

        def answer(request: Any, _: Any, kind: Any = kind, asked: list[Any] = asked) -> Any:
            asked.append(request)
            return filled(kind.Response)

        service = node.create_service(kind, f"/round_trip/{name}", answer)
        client = node.create_client(kind, f"/round_trip/{name}")
        assert client.wait_for_service(timeout_sec=60)
        future = client.call_async(filled(kind.Request))
        rclpy.spin_until_future_complete(node, future)
        assert asked == [filled(kind.Request)]
        assert future.result() == filled(kind.Response)
        node.destroy_client(client)
        node.destroy_service(service)

    for name in sorted(file.stem for file in FILES if file.suffix == ".action"):
        kind = getattr(action, name)
        goals: list[Any] = []

        def execute(handle: Any, kind: Any = kind, goals: list[Any] = goals) -> Any:
            goals.append(handle.request)
            handle.publish_feedback(filled(kind.Feedback))
            handle.succeed()
            return filled(kind.Result)

        server = ActionServer(node, kind, f"/round_trip/{name}", execute)
        caller = ActionClient(node, kind, f"/round_trip/{name}")
        assert caller.wait_for_server(timeout_sec=60)
        feedback: list[Any] = []
        goal = caller.send_goal_async(
            filled(kind.Goal), lambda heard, feedback=feedback: feedback.append(heard.feedback)
        )
        rclpy.spin_until_future_complete(node, goal)
        result = goal.result().get_result_async()
        rclpy.spin_until_future_complete(node, result)
        while not feedback:
            rclpy.spin_once(node, timeout_sec=0.05)
        assert goals == [filled(kind.Goal)]
        assert feedback == [filled(kind.Feedback)]
        assert result.result().result == filled(kind.Result)
        caller.destroy()
        server.destroy()
