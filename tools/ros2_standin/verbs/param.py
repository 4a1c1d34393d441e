# SPDX-License-Identifier: Apache-2.0
"""Various param related sub-commands"""

import argparse
import re
import sys
from collections.abc import Callable
from typing import Any

import rclpy
from rcl_interfaces.msg import Parameter, ParameterType
from rclpy.node import Node
from rclpy.parameter import get_parameter_value, parameter_value_to_python
from rclpy.parameter_client import AsyncParameterClient

from ros2_standin import graph
from ros2_standin.verbs import add_verbs

NAME = "param"
SERVICE_TIMEOUT = 5.0  # s

# Type of a parameter -> its name in `param list`, and the words before its value in `param get`.
KINDS = {
    ParameterType.PARAMETER_NOT_SET: ("not set", "Parameter not set."),
    ParameterType.PARAMETER_BOOL: ("boolean", "Boolean value is:"),
    ParameterType.PARAMETER_INTEGER: ("integer", "Integer value is:"),
    ParameterType.PARAMETER_DOUBLE: ("double", "Double value is:"),
    ParameterType.PARAMETER_STRING: ("string", "String value is:"),
    ParameterType.PARAMETER_BYTE_ARRAY: ("byte array", "Byte values are:"),
    ParameterType.PARAMETER_BOOL_ARRAY: ("boolean array", "Boolean values are:"),
    ParameterType.PARAMETER_INTEGER_ARRAY: ("integer array", "Integer values are:"),
    ParameterType.PARAMETER_DOUBLE_ARRAY: ("double array", "Double values are:"),
    ParameterType.PARAMETER_STRING_ARRAY: ("string array", "String values are:"),
}


def ask(node: Node, name: str, request: Callable[[AsyncParameterClient], Any]) -> Any:
    """The response of a node's parameter service."""
    client = AsyncParameterClient(node, name)
    if not client.wait_for_services(timeout_sec=SERVICE_TIMEOUT):
        raise RuntimeError(f"Wait for service timed out waiting for parameter services for node {name}")
    future = request(client)
    rclpy.spin_until_future_complete(node, future)
    if future.result() is None:
        raise RuntimeError(f"Exception while calling service of node {name}: {future.exception()}")
    return future.result()


def found(node: Node, args: argparse.Namespace) -> bool:
    name = graph.absolute(args.node_name)
    return graph.wait_for(lambda: name in graph.node_names(node, args.include_hidden_nodes), args.timeout)


def get(args: argparse.Namespace) -> str | None:
    """Get parameter"""
    with graph.direct_node(args) as node:
        if not found(node, args):
            return "Node not found"
        values = ask(node, args.node_name, lambda client: client.get_parameters([args.parameter_name])).values
    if not values:
        return "Parameter not set"
    label = KINDS[values[0].type][1]
    value = parameter_value_to_python(values[0])
    value = value.tolist() if hasattr(value, "tolist") else value
    if args.hide_type:
        print(value)
    else:
        print(label) if value is None else print(label, value)
    return None


def set_(args: argparse.Namespace) -> str | None:
    """Set parameter"""
    with graph.direct_node(args) as node:
        if not found(node, args):
            return "Node not found"
        parameter = Parameter(name=args.parameter_name, value=get_parameter_value(args.value))
        result = ask(node, args.node_name, lambda client: client.set_parameters([parameter])).results[0]
    reason = f": {result.reason}" if result.reason else ""
    if result.successful:
        print(f"Set parameter successful{reason}")
    else:
        print(f"Setting parameter failed{reason}", file=sys.stderr)
    return None


def describe(args: argparse.Namespace) -> str | None:
    """Show descriptive information about declared parameters"""
    with graph.direct_node(args) as node:
        if not found(node, args):
            return "Node not found"
        descriptors = ask(node, args.node_name, lambda client: client.describe_parameters(args.parameter_names))
    for told in descriptors.descriptors:
        print(f"Parameter name: {told.name}\n  Type: {KINDS[told.type][0]}")
        if told.description:
            print(f"  Description: {told.description}")
        print("  Constraints:")
        if told.read_only:
            print("    Read only: true")
        for bounds in [*told.floating_point_range, *told.integer_range][:1]:
            print(f"    Min value: {bounds.from_value}\n    Max value: {bounds.to_value}")
            if bounds.step:
                print(f"    Step: {bounds.step}")
        if told.additional_constraints:
            print(f"    Additional constraints: {told.additional_constraints}")
    return None


def list_(args: argparse.Namespace) -> str | None:
    """Output a list of available parameters"""
    with graph.direct_node(args) as node:
        if args.node_name:
            args.timeout = graph.NAMED_TIME
            if not found(node, args):
                return "Node not found"
            nodes = [graph.absolute(args.node_name)]
        else:
            nodes = sorted(graph.node_names(node, args.include_hidden_nodes))
        for name in nodes:
            try:
                _print_parameters(node, name, args)
            except RuntimeError as error:
                print(error)
    return None


def _print_parameters(node: Node, name: str, args: argparse.Namespace) -> None:
    listed = ask(node, name, lambda client: client.list_parameters(args.param_prefixes)).result.names
    names = sorted(n for n in listed if args.filter is None or re.match(args.filter[0], n))
    if names and not args.node_name:
        print(f"{name}:")
    types = {}
    if args.param_type:
        descriptors = ask(node, name, lambda client: client.describe_parameters(names)).descriptors
        types = {descriptor.name: f" (type: {KINDS[descriptor.type][0]})" for descriptor in descriptors}
    for parameter in names:
        print(f"  {parameter}{types.get(parameter, '')}")


def _common_arguments(parser: argparse.ArgumentParser, **node_options: Any) -> None:
    graph.add_arguments(parser)
    parser.add_argument("node_name", help="Name of the ROS node", **node_options)
    parser.add_argument("--include-hidden-nodes", action="store_true", help="Consider hidden nodes as well")


def _timeout_argument(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--timeout",
        metavar="N",
        type=int,
        default=graph.NAMED_TIME,
        help="Wait for N seconds until node becomes available (default %(default)g sec)",
    )


def _get_arguments(parser: argparse.ArgumentParser) -> None:
    _common_arguments(parser)
    parser.add_argument("parameter_name", help="Name of the parameter")
    parser.add_argument("--hide-type", action="store_true", help="Hide the type information")
    _timeout_argument(parser)


def _set_arguments(parser: argparse.ArgumentParser) -> None:
    _common_arguments(parser)
    parser.add_argument("parameter_name", help="Name of the parameter")
    parser.add_argument("value", help="Value of the parameter")
    _timeout_argument(parser)


def _describe_arguments(parser: argparse.ArgumentParser) -> None:
    _common_arguments(parser)
    parser.add_argument("parameter_names", nargs="+", help="Names of the parameters")
    parser.set_defaults(timeout=graph.NAMED_TIME)


def _list_arguments(parser: argparse.ArgumentParser) -> None:
    _common_arguments(parser, nargs="?")
    parser.add_argument("--filter", nargs=1, help="Only parameters matching the regex expression will be showed.")
    parser.add_argument("--param-prefixes", nargs="+", default=[], help="Only list parameters with these prefixes")
    parser.add_argument("--param-type", action="store_true", help="Print parameter types with parameter names")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_verbs(
        parser,
        NAME,
        {
            "describe": (describe, _describe_arguments),
            "get": (get, _get_arguments),
            "list": (list_, _list_arguments),
            "set": (set_, _set_arguments),
        },
    )
