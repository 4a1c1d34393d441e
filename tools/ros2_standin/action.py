# SPDX-License-Identifier: Apache-2.0
"""`ros2 action`: actions, their ends, and goals."""

import argparse
from typing import Any

import rclpy
import rclpy.action
from action_msgs.msg import GoalStatus
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from ros2_standin import graph
from ros2_standin.cli import argument, flag, verb
from ros2_standin.messages import STDIN, fill, given_values, interface, to_yaml

ACTION = argument("action_name", help="Name of the ROS action (e.g. '/fibonacci')")
TYPES = flag("-t", "--show-types", help="Additionally show the action type")
STATUS = {getattr(GoalStatus, f"STATUS_{name}"): name for name in ("SUCCEEDED", "CANCELED", "ABORTED")}


@verb(*graph.OPTIONS, TYPES, flag("-c", "--count-actions", help="Only display the number of actions"))
def list_(args: argparse.Namespace) -> None:
    """Output a list of action names"""
    with graph.known_graph(args) as node:
        pairs = rclpy.action.get_action_names_and_types(node)
    graph.print_names(pairs, args.show_types, args.count_actions)


@verb(*graph.OPTIONS, ACTION, TYPES, flag("-c", "--count", help="Only display the number of clients and servers"))
def info(args: argparse.Namespace) -> None:
    """Print information about an action"""
    name = graph.absolute(args.action_name)
    by_node = {
        "clients": rclpy.action.get_action_client_names_and_types_by_node,
        "servers": rclpy.action.get_action_server_names_and_types_by_node,
    }
    with graph.known_graph(args) as node:
        graph.wait_for(lambda: name in dict(rclpy.action.get_action_names_and_types(node)))
        print(f"Action: {args.action_name}")
        for title, ends in by_node.items():
            there: dict[str, list[str]] = {}
            for full in graph.node_names(node):
                space, _, short = full.rpartition("/")
                if types := dict(ends(node, short, space or "/")).get(name):
                    there[full] = types
            print(f"Action {title}: {len(there)}")
            for full, types in () if args.count else there.items():
                print(f"    {full} [{', '.join(types)}]" if args.show_types else f"    {full}")


@verb(
    ACTION,
    argument("action_type", help="Type of the ROS action (e.g. 'example_interfaces/action/Fibonacci')"),
    argument("goal", nargs="?", default="{}", help="Goal request values in YAML format (e.g. '{order: 10}')"),
    STDIN,
    flag("-f", "--feedback", help="Echo feedback messages for the goal"),
)
def send_goal(args: argparse.Namespace) -> str | None:
    """Send an action goal"""
    kind = interface(args.action_type, "action")
    goal = kind.Goal()
    try:
        fill(goal, given_values(args, args.goal))
    except Exception as error:
        return f"Failed to populate message fields: {error!r}"
    # Ctrl-C must leave the context alive, so that the goal can still be cancelled.
    with graph.plain_node("ros2cli_send_goal", signal_handler_options=SignalHandlerOptions.NO) as node:
        client = rclpy.action.ActionClient(node, kind, args.action_name)
        try:
            print("Waiting for an action server to become available...")
            client.wait_for_server()
            print(f"Sending goal:\n     {to_yaml(goal)}")
            _follow(node, client, goal, args.feedback)
        finally:
            client.destroy()
    return None


def _follow(node: Node, client: Any, goal: Any, feedback: bool) -> None:
    def show(message: Any) -> None:
        print(f"Feedback:\n    {to_yaml(message.feedback)}")

    handle = _wait(node, client.send_goal_async(goal, show if feedback else None), "sending goal")
    if not handle.accepted:
        print("Goal was rejected.")
        return
    print(f"Goal accepted with ID: {bytes(handle.goal_id.uuid).hex()}\n")
    try:
        result = _wait(node, handle.get_result_async(), "getting result")
    except BaseException:
        if handle.status in (GoalStatus.STATUS_ACCEPTED, GoalStatus.STATUS_EXECUTING):
            print("Canceling goal...")
            if not _wait(node, handle.cancel_goal_async(), "canceling goal").goals_canceling:
                raise RuntimeError("Failed to cancel goal") from None
            print("Goal canceled.")
        raise
    print(f"Result:\n    {to_yaml(result.result)}")
    print(f"Goal finished with status: {STATUS.get(result.status, 'UNKNOWN')}")


def _wait(node: Node, future: Any, what: str) -> Any:
    rclpy.spin_until_future_complete(node, future)
    if future.result() is None:
        raise RuntimeError(f"Exception while {what}: {future.exception()!r}")
    return future.result()
