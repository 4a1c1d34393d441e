# SPDX-License-Identifier: Apache-2.0
"""Various action related sub-commands"""

import argparse
import sys
from typing import Any

import rclpy
import rclpy.action
import yaml
from action_msgs.msg import GoalStatus
from rclpy.node import Node

from ros2_standin import graph
from ros2_standin.messages import INVALID, fill, interface, to_yaml
from ros2_standin.verbs import add_verbs

NAME = "action"
STATUS = {
    GoalStatus.STATUS_ACCEPTED: "ACCEPTED",
    GoalStatus.STATUS_EXECUTING: "EXECUTING",
    GoalStatus.STATUS_CANCELING: "CANCELING",
    GoalStatus.STATUS_SUCCEEDED: "SUCCEEDED",
    GoalStatus.STATUS_CANCELED: "CANCELED",
    GoalStatus.STATUS_ABORTED: "ABORTED",
}


def list_(args: argparse.Namespace) -> None:
    """Output a list of action names"""
    with graph.direct_node(args) as node:
        pairs = rclpy.action.get_action_names_and_types(node)
    graph.print_names(pairs, args.show_types, args.count_actions)


def send_goal(args: argparse.Namespace) -> str | None:
    """Send an action goal"""
    try:
        kind = interface(args.action_type, "action")
    except INVALID:
        raise RuntimeError("The passed action type is invalid") from None
    values = yaml.safe_load(sys.stdin.read() if args.stdin else args.goal)
    # Ctrl-C must leave the context alive, so that the goal can still be cancelled.
    rclpy.init(args=[], signal_handler_options=rclpy.signals.SignalHandlerOptions.NO)
    node = rclpy.create_node(f"{graph.NODE_NAME_PREFIX}_send_goal_{args.action_type.replace('/', '_')}")
    client = rclpy.action.ActionClient(node, kind, args.action_name)
    try:
        goal = kind.Goal()
        try:
            fill(goal, values)
        except Exception as error:
            return f"Failed to populate message fields: {error!r}"
        print("Waiting for an action server to become available...")
        client.wait_for_server()
        print(f"Sending goal:\n     {to_yaml(goal)}")
        _follow(node, client, goal, _print_feedback if args.feedback else None)
    finally:
        client.destroy()
        node.destroy_node()
        rclpy.try_shutdown()
    return None


def _follow(node: Node, client: Any, goal: Any, feedback: Any) -> None:
    handle = _wait(node, client.send_goal_async(goal, feedback), "sending goal")
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


def _print_feedback(feedback: Any) -> None:
    print(f"Feedback:\n    {to_yaml(feedback.feedback)}")


def _list_arguments(parser: argparse.ArgumentParser) -> None:
    graph.add_arguments(parser)
    parser.add_argument("-t", "--show-types", action="store_true", help="Additionally show the action type")
    parser.add_argument("-c", "--count-actions", action="store_true", help="Only display the number of actions")


def _send_goal_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("action_name", help="Name of the ROS action (e.g. '/fibonacci')")
    parser.add_argument("action_type", help="Type of the ROS action (e.g. 'example_interfaces/action/Fibonacci')")
    source = parser.add_mutually_exclusive_group()
    source.add_argument("goal", nargs="?", default="{}", help="Goal request values in YAML format (e.g. '{order: 10}')")
    source.add_argument("--stdin", action="store_true", help="Read goal from standard input")
    parser.add_argument("-f", "--feedback", action="store_true", help="Echo feedback messages for the goal")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_verbs(parser, NAME, {"list": (list_, _list_arguments), "send_goal": (send_goal, _send_goal_arguments)})
