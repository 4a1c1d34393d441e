# SPDX-License-Identifier: Apache-2.0
"""`ros2 topic pub`: one message, or the same one again and again."""

import argparse
import sys
import time
from collections.abc import Callable
from typing import Any

import rclpy
import yaml
from rclpy.node import Node

from ros2_standin import qos
from ros2_standin.messages import INVALID, fill, interface


def pub(node: Node, args: argparse.Namespace) -> str | None:
    try:
        kind = interface(args.message_type, "msg")
    except INVALID:
        raise RuntimeError("The passed message type is invalid") from None
    values = yaml.safe_load(sys.stdin.read() if args.stdin else args.values)
    if not isinstance(values, dict):
        return "The passed value needs to be a dictionary in YAML format"
    times = 1 if args.once else args.times
    wanted = args.wait_matching_subscriptions
    wanted = int(times != 0) if wanted is None else wanted
    if wanted == 0 and args.max_wait_time_secs is not None:
        return "--max-wait-time-secs option is only effective with --wait-matching-subscriptions, --once or --times"
    publisher = node.create_publisher(kind, args.topic_name, qos.from_arguments(args))
    if complaint := _wait(publisher, wanted, args.max_wait_time_secs):
        return complaint
    message, stamps = kind(), list[Callable[[Any], None]]()
    try:
        fill(message, values, stamps)
    except Exception as error:
        return f"Failed to populate field: {error}"
    _loop(node, publisher, message, stamps, times, args)
    return None


def _wait(publisher: Any, wanted: int, longest: float | None) -> str | None:
    start, said = time.monotonic(), -1.0
    while (got := publisher.get_subscription_count()) < wanted:
        waited = time.monotonic() - start
        if waited - said >= 1 or said < 0:
            print(f"Waiting for at least {wanted} matching subscription(s)...")
            said = waited
        if longest is not None and waited >= longest:
            return f"Timed out waiting for subscribers: Expected {wanted} subcribers but only got {got} subscribers"
        time.sleep(0.1)
    return None


def _loop(
    node: Node, publisher: Any, message: Any, stamps: list[Callable[[Any], None]], times: int, args: argparse.Namespace
) -> None:
    print("publisher: beginning loop")
    count = 0

    def publish() -> None:
        nonlocal count
        now = node.get_clock().now().to_msg()
        for set_stamp in stamps:
            set_stamp(now)
        count += 1
        if args.print and count % args.print == 0:
            print(f"publishing #{count}: {message!r}\n")
        publisher.publish(message)

    publish()
    timer = node.create_timer(1 / args.rate, publish)
    while times == 0 or count < times:
        rclpy.spin_once(node)
    node.destroy_timer(timer)
    # Time for the last message to reach the wire.
    time.sleep(args.keep_alive)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("message_type", help="Type of the ROS message (e.g. 'std_msgs/String')")
    source = parser.add_mutually_exclusive_group()
    source.add_argument("values", nargs="?", default="{}", help="Values to fill the message with in YAML format")
    source.add_argument("--stdin", action="store_true", help="Read values from standard input")
    parser.add_argument("-r", "--rate", metavar="N", type=float, default=1.0, help="Publishing rate in Hz (default: 1)")
    parser.add_argument(
        "-p", "--print", metavar="N", type=int, default=1, help="Only print every N-th published message"
    )
    count = parser.add_mutually_exclusive_group()
    count.add_argument("-1", "--once", action="store_true", help="Publish one message and exit")
    count.add_argument("-t", "--times", type=int, default=0, help="Publish this number of times and then exit")
    parser.add_argument(
        "-w",
        "--wait-matching-subscriptions",
        type=int,
        help="Wait until finding the specified number of matching subscriptions. Defaults to 1 with --once or --times.",
    )
    parser.add_argument("--max-wait-time-secs", type=float, help="The longest wait for matching subscriptions")
    parser.add_argument("--keep-alive", metavar="N", type=float, default=0.1, help="Stay N seconds after the last msg")
    parser.add_argument("-n", "--node-name", help="Name of the created publishing node")
    qos.add_arguments(parser, "publish", "default")
