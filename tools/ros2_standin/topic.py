# SPDX-License-Identifier: Apache-2.0
"""`ros2 topic`: what is published, and to publish."""

import argparse
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import rclpy
from rclpy.expand_topic_name import expand_topic_name
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from rclpy.task import Future
from rclpy.validate_full_topic_name import validate_full_topic_name

from ros2_standin import graph, qos
from ros2_standin.cli import argument, flag, verb
from ros2_standin.messages import SHORTENING, STDIN, fill, given_values, interface, to_yaml

TOPIC = argument("topic_name", help="Name of the ROS topic (e.g. '/chatter')")
HIDDEN = flag("--include-hidden-topics", help="Consider hidden topics as well")


def types_of(node: Node, topic: str) -> list[str]:
    """The types under which a topic is known; empty if it is not, after a while."""
    try:
        full = expand_topic_name(topic, node.get_name(), node.get_namespace())
        validate_full_topic_name(full)
    except (ValueError, rclpy.exceptions.InvalidTopicNameException) as error:
        raise RuntimeError(error) from None
    return list(graph.wait_for(lambda: dict(node.get_topic_names_and_types()).get(full)) or [])


def message_class(node: Node, topic: str) -> Any:
    """The class of a topic's messages, or None if it has no publisher."""
    types = types_of(node, topic)
    if not types:
        print(f"WARNING: topic [{topic}] does not appear to be published yet")
    if len(types) > 1:
        raise RuntimeError(f"Cannot echo topic '{topic}', as it contains more than one type: [{', '.join(types)}]")
    return interface(types[0], "msg") if types else None


@verb(
    *graph.OPTIONS,
    flag("-t", "--show-types", help="Additionally show the topic type"),
    flag("-c", "--count-topics", help="Only display the number of topics discovered"),
    HIDDEN,
    flag("-v", "--verbose", help="List full details about each topic"),
)
def list_(args: argparse.Namespace) -> None:
    """Output a list of available topics"""
    with graph.known_graph(args) as node:
        pairs = graph.shown(node.get_topic_names_and_types(), args.include_hidden_topics)
        ends = {
            ("Published", "publisher"): [node.count_publishers(name) for name, _ in pairs],
            ("Subscribed", "subscriber"): [node.count_subscribers(name) for name, _ in pairs],
        }
    if not args.verbose or args.count_topics:
        graph.print_names(pairs, args.show_types, args.count_topics)
        return
    for (title, noun), counts in ends.items():
        print(f"{title} topics:")
        for (name, types), count in zip(pairs, counts, strict=True):
            if count:
                print(f" * {name} [{', '.join(types)}] {count} {noun}{'s' if count > 1 else ''}")
        print()


@verb(*graph.OPTIONS, TOPIC, flag("-v", "--verbose", help="Prints node names, type, GUID and QoS of each end"))
def info(args: argparse.Namespace) -> str | None:
    """Print information about a topic"""
    with graph.known_graph(args) as node:
        types = types_of(node, args.topic_name)
        if not types:
            return f"Unknown topic '{args.topic_name}'"
        end = "\n\n" if args.verbose else "\n"
        print(f"Type: {types[0] if len(types) == 1 else types}", end=end)
        for title, endpoints in (
            ("Publisher", node.get_publishers_info_by_topic),
            ("Subscription", node.get_subscriptions_info_by_topic),
        ):

            def named(endpoints: Callable[[str], list[Any]] = endpoints) -> bool:
                return all(graph.UNKNOWN not in endpoint.node_name for endpoint in endpoints(args.topic_name))

            graph.wait_for(named)
            print(f"{title} count: {len(endpoints(args.topic_name))}", end=end)
            for endpoint in endpoints(args.topic_name) if args.verbose else ():
                print(endpoint, end=end)
    return None


@verb(*graph.OPTIONS, TOPIC)
def type_(args: argparse.Namespace) -> int | None:
    """Print a topic's type"""
    with graph.known_graph(args, whole=False) as node:
        types = types_of(node, args.topic_name)
    if types:
        print(*types, sep="\n")
    return None if types else 1


@verb(
    *graph.OPTIONS,
    TOPIC,
    argument("message_type", nargs="?", help="Type of the ROS message (e.g. 'std_msgs/msg/String')"),
    *qos.options("sensor_data"),
    argument("--field", help="Echo a selected field of a message. Use '.' to select sub-fields."),
    *SHORTENING,
    flag("--once", help="Print the first message received and then exit."),
    argument("--timeout", metavar="N", type=float, help="Set a timeout in seconds for waiting"),
)
def echo(args: argparse.Namespace) -> None:
    """Output messages from a topic"""
    done: Future = Future()

    def heard(message: Any) -> None:
        for part in (args.field or "").split(".") if args.field else ():
            try:
                message = getattr(message, part)
            except AttributeError as error:
                raise RuntimeError(f"Invalid field '{args.field}': {error}") from None
        print(to_yaml(message, args) if hasattr(message, "SLOT_TYPES") else f"{message}\n", end="---\n")
        if args.once:
            done.set_result(True)

    with graph.known_graph(args) as node:
        given = args.message_type
        kind = interface(given, "msg") if given else message_class(node, args.topic_name)
        if kind is None:
            raise RuntimeError("Could not determine the type for the passed topic")
        node.create_subscription(kind, args.topic_name, heard, qos.matching(node, args.topic_name, args))
        rclpy.spin_until_future_complete(node, done, timeout_sec=args.timeout)


@verb(
    *graph.OPTIONS,
    TOPIC,
    argument("-w", "--window", metavar="N", type=int, default=10000, help="messages to a rate (default: %(default)s)"),
    flag("--wall-time", help="calculates rate using wall time"),
)
def hz(args: argparse.Namespace) -> None:
    """Print the average publishing rate to screen"""
    times: list[float] = []  # s
    shown_before = 0.0

    def count(_: Any) -> None:
        now = time.time() if args.wall_time else node.get_clock().now().nanoseconds * 1e-9
        if times and now < times[-1]:
            times.clear()  # the clock went back
        times.append(now)
        del times[: -args.window - 1]

    def show() -> None:
        nonlocal shown_before
        if len(times) < 2 or times[-1] == shown_before:
            return
        shown_before = times[-1]
        steps = np.diff(times)
        rate = 1 / steps.mean() if steps.mean() > 0 else 0.0
        print(f"average rate: {rate:.3f}")
        spread = f"std dev: {steps.std():.5f}s window: {len(steps)}"
        print(f"\tmin: {steps.min():.3f}s max: {steps.max():.3f}s {spread}")

    with graph.known_graph(args, whole=False) as node:
        while (kind := message_class(node, args.topic_name)) is None:
            pass
        node.create_subscription(kind, args.topic_name, count, qos_profile_sensor_data)
        node.create_timer(1.0, show, clock=rclpy.clock.Clock())
        rclpy.spin(node)


@verb(
    *graph.OPTIONS,
    TOPIC,
    argument("message_type", help="Type of the ROS message (e.g. 'std_msgs/String')"),
    argument("values", nargs="?", default="{}", help="Values to fill the message with in YAML format"),
    STDIN,
    argument("-r", "--rate", metavar="N", type=float, default=1.0, help="Publishing rate in Hz (default: 1)"),
    argument("-p", "--print", metavar="N", type=int, default=1, help="Only print every N-th published message"),
    argument("-1", "--once", dest="times", action="store_const", const=1, help="Publish one message and exit"),
    argument("-t", "--times", type=int, default=0, help="Publish this number of times and then exit"),
    argument(
        "-w",
        "--wait-matching-subscriptions",
        type=int,
        help="Wait for so many matching subscriptions. Defaults to 1 with --once or --times.",
    ),
    argument("--keep-alive", metavar="N", type=float, default=0.1, help="Stay N seconds after the last msg"),
    *qos.options("default"),
)
def pub(args: argparse.Namespace) -> str | None:
    """Publish a message to a topic"""
    kind = interface(args.message_type, "msg")
    message, stamps = kind(), list[Callable[[Any], None]]()
    try:
        fill(message, given_values(args, args.values), stamps)
    except Exception as error:
        return f"Failed to populate field: {error}"
    wanted = args.wait_matching_subscriptions
    wanted = int(args.times != 0) if wanted is None else wanted
    with graph.plain_node("ros2cli_pub", args.use_sim_time) as node:
        publisher = node.create_publisher(kind, args.topic_name, qos.from_options(args))
        while publisher.get_subscription_count() < wanted:
            print(f"Waiting for at least {wanted} matching subscription(s)...")
            graph.wait_for(lambda: publisher.get_subscription_count() >= wanted, 1.0)
        print("publisher: beginning loop")
        count = 0

        def publish() -> None:
            nonlocal count
            count += 1
            for set_stamp in stamps:
                set_stamp(node.get_clock().now().to_msg())
            if args.print and count % args.print == 0:
                print(f"publishing #{count}: {message!r}\n")
            publisher.publish(message)

        publish()
        node.create_timer(1 / args.rate, publish)
        while args.times == 0 or count < args.times:
            rclpy.spin_once(node)
        time.sleep(args.keep_alive)  # for the last message to reach the wire
    return None
