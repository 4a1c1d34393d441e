# SPDX-License-Identifier: Apache-2.0
"""A hidden node that has looked around long enough to know the graph."""

import argparse
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import rclpy
from rclpy.node import HIDDEN_NODE_PREFIX, Node
from rclpy.parameter import Parameter

from ros2_standin.cli import argument, flag

# The real ros2 has a daemon that knows the graph at once. Here every command discovers anew.
QUIET_TIME = 0.5  # s without news after which the graph counts as known
LONGEST_TIME = 12.0  # s to wait for those on this machine that have not answered yet
NAMED_TIME = 4.0  # s to look for what was asked for by name
BUSIEST = 8.0  # the most by which the first and the last of these grow on a busy machine
UNKNOWN = "_UNKNOWN_"  # in the name of the node of an end of which nothing else is known yet
UDP_TABLES = (Path("/proc/net/udp"), Path("/proc/net/udp6"))

OPTIONS = (
    argument("--spin-time", type=float, help="Seconds to wait for discovery (default: until no news comes)"),
    flag("-s", "--use-sim-time", help="Enable ROS simulation time"),
    flag("--no-daemon", help="Accepted for the sake of scripts; there is no daemon here"),
)


def patience() -> float:
    """By what discovery takes longer than on an idle machine: how many processes there are to a processor."""
    return min(max(1.0, os.getloadavg()[0] / (os.cpu_count() or 1)), BUSIEST)


@contextmanager
def known_graph(args: argparse.Namespace, whole: bool = True) -> Iterator[Node]:
    """A node that has looked around as the options of `args` say; not `whole`: the caller waits for what it needs."""
    with plain_node(f"ros2cli_{os.getpid()}", args.use_sim_time) as node:
        if whole or args.spin_time is not None:
            look_around(node, args.spin_time)
        yield node


@contextmanager
def plain_node(name: str, use_sim_time: bool = False, **options: Any) -> Iterator[Node]:
    rclpy.init(args=[], **options)
    node = rclpy.create_node(
        f"{HIDDEN_NODE_PREFIX}{name}",
        start_parameter_services=False,
        parameter_overrides=[Parameter("use_sim_time", value=use_sim_time)],
        automatically_declare_parameters_from_overrides=True,
    )
    try:
        yield node
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


def look_around(node: Node, seconds: float | None) -> None:
    """Spins for so many seconds; without a number until all on this machine have answered and there is no more news."""
    start = last_news = time.monotonic()
    seen = -1
    while True:
        now = time.monotonic()
        known = len(node.get_node_names()) + sum(len(types) for _, types in node.get_topic_names_and_types())
        if known != seen:
            seen, last_news = known, now
        if seconds is None:
            end = last_news + QUIET_TIME * patience() if all_answered(node) else start + LONGEST_TIME
        else:
            end = start + seconds
        if now >= end:
            return
        rclpy.spin_once(node, timeout_sec=min(0.05, end - now))


def all_answered(node: Node) -> bool:
    """Whether every participant of the domain on this machine is known, with the names of its nodes.

    Each holds a UDP port of its own, 7410 + 250 domain + 2 n (RTPS 9.6.1), and publishes ros_discovery_info. Busy ones
    answer late, or not before they announce themselves again, every 3 s.
    """
    first = 7410 + 250 * node.context.get_domain_id()
    lines = [line for table in UDP_TABLES if table.is_file() for line in table.read_text().splitlines()[1:]]
    ports = {int(line.split()[1].rpartition(":")[2], 16) for line in lines}
    here = ports & set(range(first, first + 240, 2))
    publishers = node.get_publishers_info_by_topic("ros_discovery_info", no_mangle=True)
    return len({bytes(publisher.endpoint_gid)[:12] for publisher in publishers}) >= len(here) and not any(
        UNKNOWN in publisher.node_name for publisher in node.get_publishers_info_by_topic("/rosout")
    )


def wait_for(true: Callable[[], Any], seconds: float | None = None) -> Any:
    """The first result that counts as true, or the last; without a number of seconds as long as the machine needs."""
    end = time.monotonic() + (NAMED_TIME * patience() if seconds is None else seconds)
    while not (result := true()) and time.monotonic() < end:
        time.sleep(0.1)
    return result


def hidden(name: str) -> bool:
    return any(part.startswith(HIDDEN_NODE_PREFIX) for part in name.split("/"))


def shown(pairs: list[tuple[str, list[str]]], with_hidden: bool = False) -> list[tuple[str, list[str]]]:
    """Names and types without the hidden ones."""
    return [pair for pair in pairs if with_hidden or not hidden(pair[0])]


def node_names(node: Node, with_hidden: bool = False) -> list[str]:
    """Full names of the nodes in the graph, sorted, as many times as they are there."""
    pairs = node.get_node_names_and_namespaces()
    return sorted(f"{space.rstrip('/')}/{name}" for name, space in pairs if with_hidden or not hidden(name))


def found(node: Node, name: str, seconds: float | None = None) -> bool:
    """Whether a node of this full name is in the graph, waiting for it."""
    return bool(wait_for(lambda: absolute(name) in node_names(node, with_hidden=True), seconds))


def absolute(name: str) -> str:
    return name if name.startswith("/") else f"/{name}"


def print_names(pairs: list[tuple[str, list[str]]], show_types: bool, count: bool) -> None:
    if count:
        print(len(pairs))
        return
    for name, types in pairs:
        print(f"{name} [{', '.join(types)}]" if show_types else name)
