# SPDX-License-Identifier: Apache-2.0
"""`ros2 param`: parameters of running nodes."""

import argparse
import re
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import rclpy
import yaml
from rcl_interfaces.msg import Parameter
from rclpy.node import Node
from rclpy.parameter import get_parameter_value, parameter_dict_from_yaml_file, parameter_value_to_python
from rclpy.parameter_client import AsyncParameterClient

from ros2_standin import graph
from ros2_standin.cli import argument, flag, verb

SERVICE_TIMEOUT = 5.0  # s
TIMEOUT = argument("--timeout", metavar="N", type=float, help="Wait for N seconds until node becomes available")
HIDDEN = flag("--include-hidden-nodes", help="Consider hidden nodes as well")
NODE = (*graph.OPTIONS, HIDDEN, TIMEOUT, argument("node_name", help="Name of the ROS node"))
PARAMETER = argument("parameter_name", help="Name of the parameter")

# The types of parameters in the order of rcl_interfaces/ParameterType.
SINGLE = ("boolean", "integer", "double", "string")
KINDS = ("not set", *SINGLE, *(f"{kind} array" for kind in ("byte", *SINGLE)))


@contextmanager
def asking(args: argparse.Namespace) -> Iterator[Callable[..., Any]]:
    """ask(verb, *arguments) calls the parameter service of that name of the node that `args` names.

    Raises:
        RuntimeError: no such node, or no answer.
    """
    with graph.known_graph(args, whole=False) as node:
        if not graph.found(node, args.node_name, args.timeout):
            raise RuntimeError("Node not found")
        yield lambda verb, *arguments: ask(node, graph.absolute(args.node_name), verb, *arguments)


def ask(node: Node, name: str, verb: str, *arguments: Any) -> Any:
    client = AsyncParameterClient(node, name)
    if not client.wait_for_services(timeout_sec=SERVICE_TIMEOUT * graph.patience()):
        raise RuntimeError(f"Wait for service timed out waiting for parameter services for node {name}")
    future = getattr(client, verb)(*arguments)
    rclpy.spin_until_future_complete(node, future)
    if future.result() is None:
        raise RuntimeError(f"Exception while calling service of node {name}: {future.exception()}")
    return future.result()


def plain(value: Any) -> Any:
    """A parameter's value as Python prints it."""
    value = parameter_value_to_python(value)
    return value.tolist() if hasattr(value, "tolist") else value


@verb(*NODE, PARAMETER, flag("--hide-type", help="Hide the type information"))
def get(args: argparse.Namespace) -> str | None:
    """Get parameter"""
    with asking(args) as ask_node:
        values = ask_node("get_parameters", [args.parameter_name]).values
    if not values:
        return "Parameter not set"
    kind = KINDS[values[0].type]
    if args.hide_type:
        print(plain(values[0]))
    elif kind == "not set":
        print("Parameter not set.")
    else:
        label = f"{kind.removesuffix(' array')} values are" if kind.endswith(" array") else f"{kind} value is"
        print(f"{label.capitalize()}:", plain(values[0]))
    return None


@verb(*NODE, PARAMETER, argument("value", help="Value of the parameter"))
def set_(args: argparse.Namespace) -> None:
    """Set parameter"""
    parameter = Parameter(name=args.parameter_name, value=get_parameter_value(args.value))
    with asking(args) as ask_node:
        result = ask_node("set_parameters", [parameter]).results[0]
    reason = f": {result.reason}" if result.reason else ""
    if result.successful:
        print(f"Set parameter successful{reason}")
    else:
        print(f"Setting parameter failed{reason}", file=sys.stderr)


@verb(*NODE, argument("parameter_names", nargs="+", help="Names of the parameters"))
def describe(args: argparse.Namespace) -> None:
    """Show descriptive information about declared parameters"""
    with asking(args) as ask_node:
        descriptors = ask_node("describe_parameters", args.parameter_names).descriptors
    for about in descriptors:
        print(f"Parameter name: {about.name}\n  Type: {KINDS[about.type]}")
        if about.description:
            print(f"  Description: {about.description}")
        print("  Constraints:")
        if about.read_only:
            print("    Read only: true")
        for bounds in [*about.floating_point_range, *about.integer_range][:1]:
            print(f"    Min value: {bounds.from_value}\n    Max value: {bounds.to_value}")
            if bounds.step:
                print(f"    Step: {bounds.step}")
        if about.additional_constraints:
            print(f"    Additional constraints: {about.additional_constraints}")


@verb(*NODE)
def dump(args: argparse.Namespace) -> None:
    """Show all of the parameters of a node in a YAML file format"""
    with asking(args) as ask_node:
        names = sorted(ask_node("list_parameters", []).result.names)
        values = ask_node("get_parameters", names).values
    tree: dict[str, Any] = {}
    for name, value in zip(names, values, strict=True):
        *groups, last = name.split(".")
        branch = tree
        for group in groups:
            branch = branch.setdefault(group, {})
        branch[last] = plain(value)
    print(yaml.dump({graph.absolute(args.node_name): {"ros__parameters": tree}}, default_flow_style=False))


@verb(
    *NODE,
    argument("parameter_file", help="Parameter file"),
    flag("--no-use-wildcard", help="Do not load parameters in the '/**' namespace into the node"),
)
def load(args: argparse.Namespace) -> None:
    """Load parameter file for a node"""
    wildcard = not args.no_use_wildcard
    name = graph.absolute(args.node_name)
    try:
        parameters = list(parameter_dict_from_yaml_file(args.parameter_file, wildcard, [name]).values())
    except (OSError, yaml.YAMLError) as error:
        raise RuntimeError(f"{args.parameter_file}: {error}") from None
    with asking(args) as ask_node:
        results = ask_node("set_parameters", parameters).results
    for parameter, result in zip(parameters, results, strict=True):
        reason = f": {result.reason}" if result.reason else ""
        words = f"Set parameter {parameter.name} {'successful' if result.successful else 'failed'}{reason}"
        print(words, file=sys.stdout if result.successful else sys.stderr)


@verb(
    *graph.OPTIONS,
    HIDDEN,
    argument("node_name", nargs="?", help="Name of the ROS node"),
    argument("--filter", help="Only parameters matching the regex expression will be showed."),
    argument("--param-prefixes", nargs="+", default=[], help="Only list parameters with these prefixes"),
    flag("--param-type", help="Print parameter types with parameter names"),
)
def list_(args: argparse.Namespace) -> str | None:
    """Output a list of available parameters"""
    with graph.known_graph(args, whole=not args.node_name) as node:
        if args.node_name and not graph.found(node, args.node_name):
            return "Node not found"
        one = [graph.absolute(args.node_name)] if args.node_name else None
        for name in one or graph.node_names(node, args.include_hidden_nodes):
            try:
                names = ask(node, name, "list_parameters", args.param_prefixes).result.names
                names = sorted(n for n in names if re.match(args.filter or "", n))
                types = ask(node, name, "describe_parameters", names).descriptors if args.param_type else ()
            except RuntimeError as error:
                print(error)
                continue
            if names and not one:
                print(f"{name}:")
            kinds = {descriptor.name: f" (type: {KINDS[descriptor.type]})" for descriptor in types}
            for parameter in names:
                print(f"  {parameter}{kinds.get(parameter, '')}")
    return None
