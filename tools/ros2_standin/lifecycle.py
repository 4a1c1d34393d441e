# SPDX-License-Identifier: Apache-2.0
"""`ros2 lifecycle`: states of lifecycle nodes."""

import argparse
import sys
from typing import Any

import rclpy
from lifecycle_msgs.srv import ChangeState, GetAvailableTransitions, GetState
from rclpy.node import Node

from ros2_standin import graph
from ros2_standin.cli import argument, flag, verb

NODE = argument("node_name", help="Name of the ROS node")


def ask(node: Node, name: str, kind: Any, service: str, **fields: Any) -> Any:
    """The response of a lifecycle node's service. Raises RuntimeError where no such service comes up."""
    client = node.create_client(kind, f"{graph.absolute(name)}/{service}")
    if not client.wait_for_service(timeout_sec=graph.NAMED_TIME * graph.patience()):
        raise RuntimeError("Node not found")
    future = client.call_async(kind.Request(**fields))
    rclpy.spin_until_future_complete(node, future)
    if future.result() is None:
        raise RuntimeError(f"Exception while calling service of node '{name}': {future.exception()}")
    return future.result()


def lifecycle_nodes(node: Node) -> list[str]:
    """Full names of the nodes that have a state."""
    services = dict(node.get_service_names_and_types())
    kind = "lifecycle_msgs/srv/GetState"
    return sorted(name.removesuffix("/get_state") for name, types in services.items() if kind in types)


@verb(*graph.OPTIONS, flag("-c", "--count-nodes", help="Only display the number of nodes discovered"))
def nodes(args: argparse.Namespace) -> None:
    """Output a list of nodes with lifecycle"""
    with graph.known_graph(args) as node:
        names = lifecycle_nodes(node)
    print(len(names)) if args.count_nodes else print(*names, sep="\n")


@verb(*graph.OPTIONS, argument("node_name", nargs="?", help="Name of the ROS node"))
def get(args: argparse.Namespace) -> None:
    """Get lifecycle state for one or more nodes"""
    with graph.known_graph(args, whole=not args.node_name) as node:
        for name in [args.node_name] if args.node_name else lifecycle_nodes(node):
            state = ask(node, name, GetState, "get_state").current_state
            print(f"{'' if args.node_name else f'{name}: '}{state.label} [{state.id}]")


@verb(*graph.OPTIONS, NODE)
def list_(args: argparse.Namespace) -> None:
    """Output a list of available transitions"""
    with graph.known_graph(args, whole=False) as node:
        answer = ask(node, args.node_name, GetAvailableTransitions, "get_available_transitions")
    for each in answer.available_transitions:
        print(
            f"- {each.transition.label} [{each.transition.id}]\n"
            f"\tStart: {each.start_state.label}\n\tGoal: {each.goal_state.label}"
        )


@verb(*graph.OPTIONS, NODE, argument("transition", help="The lifecycle transition"))
def set_(args: argparse.Namespace) -> str | None:
    """Trigger lifecycle state transition"""
    with graph.known_graph(args, whole=False) as node:
        answer = ask(node, args.node_name, GetAvailableTransitions, "get_available_transitions")
        available = [each.transition for each in answer.available_transitions]
        chosen = [t for t in available if args.transition in (t.label, str(t.id))]
        if not chosen:
            listing = "".join(f"\n- {t.label} [{t.id}]" for t in available)
            return f"Unknown transition requested, available ones are:{listing}"
        done = ask(node, args.node_name, ChangeState, "change_state", transition=chosen[0]).success
    print("Transitioning successful" if done else "Transitioning failed", file=sys.stdout if done else sys.stderr)
    return None
