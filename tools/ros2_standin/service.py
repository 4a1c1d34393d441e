# SPDX-License-Identifier: Apache-2.0
"""`ros2 service`: services and calls of them."""

import argparse

import rclpy

from ros2_standin import graph
from ros2_standin.cli import argument, flag, verb
from ros2_standin.messages import STDIN, fill, given_values, interface

SERVICE = argument("service_name", help="Name of the ROS service (e.g. '/add_two_ints')")


@verb(
    *graph.OPTIONS,
    flag("-t", "--show-types", help="Additionally show the service type"),
    flag("-c", "--count-services", help="Only display the number of services"),
    flag("--include-hidden-services", help="Consider hidden services as well"),
)
def list_(args: argparse.Namespace) -> None:
    """Output a list of available services"""
    with graph.known_graph(args) as node:
        pairs = graph.shown(node.get_service_names_and_types(), args.include_hidden_services)
    graph.print_names(pairs, args.show_types, args.count_services)


@verb(*graph.OPTIONS, SERVICE)
def type_(args: argparse.Namespace) -> int | None:
    """Output a service's type"""
    with graph.known_graph(args, whole=False) as node:
        types = graph.wait_for(lambda: dict(node.get_service_names_and_types()).get(args.service_name))
    if types:
        print(*types, sep="\n")
    return None if types else 1


@verb(
    SERVICE,
    argument("service_type", help="Type of the ROS service (e.g. 'std_srvs/srv/Empty')"),
    argument("values", nargs="?", default="{}", help="Values to fill the service request with in YAML format"),
    STDIN,
)
def call(args: argparse.Namespace) -> str | None:
    """Call a service"""
    kind = interface(args.service_type, "srv")
    request = kind.Request()
    try:
        fill(request, given_values(args, args.values))
    except Exception as error:
        return f"Failed to populate field: {error}"
    with graph.plain_node("ros2cli_requester") as node:
        client = node.create_client(kind, args.service_name)
        if not client.service_is_ready():
            print("waiting for service to become available...")
            client.wait_for_service()
        print(f"requester: making request: {request!r}\n")
        future = client.call_async(request)
        rclpy.spin_until_future_complete(node, future)
        if future.result() is None:
            raise RuntimeError(f"Exception while calling service: {future.exception()!r}")
        print(f"response:\n{future.result()!r}\n")
    return None
