# SPDX-License-Identifier: Apache-2.0
"""A hidden node that has looked around long enough to know the graph."""

import argparse
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import rclpy
from rclpy.node import HIDDEN_NODE_PREFIX, Node
from rclpy.parameter import Parameter

NODE_NAME_PREFIX = f"{HIDDEN_NODE_PREFIX}ros2cli"
SPIN_TIME = 0.5  # s without news after which the graph counts as known
LONELY_TIME = 4.0  # s to go on looking while nobody else is seen
NAMED_TIME = 3.0  # s to look for a topic or service that was asked for by name


def add_arguments(parser: argparse.ArgumentParser, daemon: bool = True) -> None:
    parser.add_argument(
        "--spin-time",
        type=float,
        help="Spin time in seconds to wait for discovery (only applies when not using an already running daemon)",
    )
    parser.add_argument("-s", "--use-sim-time", action="store_true", help="Enable ROS simulation time")
    if daemon:
        parser.add_argument(
            "--no-daemon",
            action="store_true",
            help="Do not spawn nor use an already running daemon (there is none here)",
        )


@contextmanager
def direct_node(args: argparse.Namespace, name: str | None = None) -> Iterator[Node]:
    rclpy.init(args=[])
    node = rclpy.create_node(
        name or f"{NODE_NAME_PREFIX}_{os.getpid()}",
        start_parameter_services=False,
        parameter_overrides=[Parameter("use_sim_time", value=getattr(args, "use_sim_time", False))],
        automatically_declare_parameters_from_overrides=True,
    )
    try:
        look_around(node, getattr(args, "spin_time", None))
        yield node
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


def look_around(node: Node, seconds: float | None = None) -> None:
    """Spins for so many seconds; without a number until no news came for a while.

    The real ros2 keeps a daemon that knows the graph at once. Here every command discovers anew, and on a busy machine
    half a second may be too short.
    """
    start = last_news = time.monotonic()
    seen = -1
    while True:
        now = time.monotonic()
        known = len(node.get_node_names()) + sum(len(types) for _, types in node.get_topic_names_and_types())
        if known != seen:
            seen, last_news = known, now
        if seconds is None:
            alone = all(name == node.get_name() for name in node.get_node_names())
            end = start + LONELY_TIME if alone else last_news + SPIN_TIME
        else:
            end = start + seconds
        if now >= end:
            return
        rclpy.spin_once(node, timeout_sec=min(0.05, end - now))


def wait_for(true: Callable[[], bool], timeout: float = NAMED_TIME) -> bool:
    """Whether it came true within `timeout` seconds."""
    end = time.monotonic() + timeout
    while not (found := true()) and time.monotonic() < end:
        time.sleep(0.1)
    return found


def hidden(name: str) -> bool:
    return any(part.startswith(HIDDEN_NODE_PREFIX) for part in name.split("/"))


def node_names(node: Node, include_hidden: bool) -> list[str]:
    """Full names of the nodes in the graph, as many times as they are there."""
    return [
        f"{namespace.rstrip('/')}/{name}"
        for name, namespace in node.get_node_names_and_namespaces()
        if include_hidden or (name and not name.startswith(HIDDEN_NODE_PREFIX))
    ]


def absolute(name: str) -> str:
    return name if name.startswith("/") else f"/{name}"


def print_names(pairs: list[tuple[str, list[str]]], show_types: bool, count: bool) -> None:
    if count:
        print(len(pairs))
        return
    for name, types in pairs:
        print(f"{name} [{', '.join(types)}]" if show_types else name)
