# SPDX-License-Identifier: Apache-2.0
"""Various service related sub-commands"""

import argparse
import sys
import time

import rclpy
import yaml

from ros2_standin import graph
from ros2_standin.messages import fill, interface
from ros2_standin.verbs import add_verbs

NAME = "service"


def list_(args: argparse.Namespace) -> None:
    """Output a list of available services"""
    with graph.direct_node(args) as node:
        pairs = [
            pair
            for pair in node.get_service_names_and_types()
            if args.include_hidden_services or not graph.hidden(pair[0])
        ]
    graph.print_names(pairs, args.show_types, args.count_services)


def type_(args: argparse.Namespace) -> int | None:
    """Output a service's type"""
    with graph.direct_node(args) as node:
        graph.wait_for(lambda: args.service_name in dict(node.get_service_names_and_types()))
        types = dict(node.get_service_names_and_types()).get(args.service_name)
    if types is None:
        return 1
    print("\n".join(types))
    return None


def call(args: argparse.Namespace) -> str | None:
    """Call a service"""
    if args.rate is not None and args.rate <= 0:
        raise RuntimeError("rate must be greater than zero")
    try:
        kind = interface(args.service_type, "srv")
    except (AttributeError, ModuleNotFoundError):
        raise RuntimeError("The passed service type is invalid") from None
    except ValueError as error:
        words = (
            "The passed type is not a service" if "is no srv" in str(error) else "The passed service type is invalid"
        )
        raise RuntimeError(words) from None
    values = yaml.safe_load(sys.stdin.read() if args.stdin else args.values)
    package, *_, name = args.service_type.split("/")
    rclpy.init(args=[])
    node = rclpy.create_node(f"{graph.NODE_NAME_PREFIX}_requester_{package}_{name}")
    try:
        client = node.create_client(kind, args.service_name)
        request = kind.Request()
        try:
            fill(request, values)
        except Exception as error:
            return f"Failed to populate field: {error}"
        if not client.service_is_ready():
            print("waiting for service to become available...")
            client.wait_for_service()
        while True:
            print(f"requester: making request: {request!r}\n")
            began = time.time()
            future = client.call_async(request)
            rclpy.spin_until_future_complete(node, future)
            if future.result() is None:
                raise RuntimeError(f"Exception while calling service: {future.exception()!r}")
            print(f"response:\n{future.result()!r}\n")
            if args.rate is None or not rclpy.ok():
                return None
            time.sleep(max(0.0, began + 1 / args.rate - time.time()))
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


def _list_arguments(parser: argparse.ArgumentParser) -> None:
    graph.add_arguments(parser)
    parser.add_argument("-t", "--show-types", action="store_true", help="Additionally show the service type")
    parser.add_argument("-c", "--count-services", action="store_true", help="Only display the number of services")
    _hidden_argument(parser, argparse.SUPPRESS)


def _hidden_argument(parser: argparse.ArgumentParser, default: object = False) -> None:
    parser.add_argument(
        "--include-hidden-services", action="store_true", default=default, help="Consider hidden services as well"
    )


def _type_arguments(parser: argparse.ArgumentParser) -> None:
    graph.add_arguments(parser)
    parser.add_argument("service_name", help="Name of the ROS service to get type (e.g. '/talker/list_parameters')")


def _call_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("service_name", help="Name of the ROS service to call to (e.g. '/add_two_ints')")
    parser.add_argument("service_type", help="Type of the ROS service (e.g. 'std_srvs/srv/Empty')")
    source = parser.add_mutually_exclusive_group()
    source.add_argument(
        "values", nargs="?", default="{}", help="Values to fill the service request with in YAML format"
    )
    source.add_argument("--stdin", action="store_true", help="Read values from standard input")
    parser.add_argument("-r", "--rate", metavar="N", type=float, help="Repeat the call at a specific rate in Hz")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    _hidden_argument(parser)
    add_verbs(
        parser,
        NAME,
        {"call": (call, _call_arguments), "list": (list_, _list_arguments), "type": (type_, _type_arguments)},
    )
