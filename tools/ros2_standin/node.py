# SPDX-License-Identifier: Apache-2.0
"""`ros2 node`: nodes and what they offer."""

import argparse
import sys

from rclpy.action import get_action_client_names_and_types_by_node, get_action_server_names_and_types_by_node
from rclpy.node import Node

from ros2_standin import graph
from ros2_standin.cli import argument, flag, verb


@verb(
    *graph.OPTIONS,
    flag("-a", "--all", help="Display all nodes even hidden ones"),
    flag("-c", "--count-nodes", help="Only display the number of nodes discovered"),
)
def list_(args: argparse.Namespace) -> None:
    """Output a list of available nodes"""
    with graph.known_graph(args) as node:
        names = graph.node_names(node, args.all)
    if args.count_nodes:
        print(len(names))
    elif names:
        if len(set(names)) < len(names):
            print(
                "WARNING: Be aware that there are nodes in the graph that share an exact name, "
                "which can have unintended side effects.",
                file=sys.stderr,
            )
        print(*names, sep="\n")


@verb(
    *graph.OPTIONS,
    argument("node_name", help="Fully qualified node name to request information"),
    flag("--include-hidden", help="Display hidden topics, services, and actions as well"),
)
def info(args: argparse.Namespace) -> str | None:
    """Output information about a node"""
    space, _, name = args.node_name.rpartition("/")
    asked = {
        "Subscribers": Node.get_subscriber_names_and_types_by_node,
        "Publishers": Node.get_publisher_names_and_types_by_node,
        "Service Servers": Node.get_service_names_and_types_by_node,
        "Service Clients": Node.get_client_names_and_types_by_node,
        "Action Servers": get_action_server_names_and_types_by_node,
        "Action Clients": get_action_client_names_and_types_by_node,
    }
    with graph.known_graph(args) as node:
        if not args.node_name.startswith("/") or not graph.found(node, args.node_name):
            return f"Unable to find node '{args.node_name}'"
        print(args.node_name)
        for title, ends in asked.items():
            print(f"  {title}:")
            pairs = sorted(graph.shown(ends(node, name, space or "/"), args.include_hidden))
            print(*(f"    {end}: {', '.join(types)}" for end, types in pairs), sep="\n")
    return None
