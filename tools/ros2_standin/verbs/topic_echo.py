# SPDX-License-Identifier: Apache-2.0
"""`ros2 topic echo`: messages as YAML or CSV."""

import argparse
from collections.abc import Callable
from typing import Any

import rclpy
import yaml
from rclpy.event_handler import SubscriptionEventCallbacks, UnsupportedEventTypeError
from rclpy.node import Node
from rclpy.task import Future

from ros2_standin import qos
from ros2_standin.messages import to_csv, to_yaml

TRUNCATE_LENGTH = 128


def echo(node: Node, kind: Any, args: argparse.Namespace) -> None:
    path = [part for part in (args.field or "").split(".") if part]
    if args.field is not None and not path:
        raise RuntimeError(f"Invalid field value '{args.field}'")
    keep: Callable[[Any], Any] = eval(f"lambda m: ({args.filter_expr})") if args.filter_expr else lambda m: True
    done: Future = Future()

    def heard(message: Any, info: Any) -> None:
        for part in path:
            try:
                message = getattr(message, part)
            except AttributeError as error:
                raise RuntimeError(f"Invalid field '{'.'.join(path)}': {error}") from None
        if keep(message):
            show(message, info, args)
            if args.once and not done.done():
                done.set_result(True)

    profile = qos.matching(node, args.topic_name, args)
    events = None if args.no_lost_messages else SubscriptionEventCallbacks(message_lost=_lost)
    try:
        node.create_subscription(kind, args.topic_name, heard, profile, event_callbacks=events, raw=args.raw)
    except UnsupportedEventTypeError:
        node.create_subscription(kind, args.topic_name, heard, profile, raw=args.raw)
    rclpy.spin_until_future_complete(node, done, timeout_sec=args.timeout)


def show(message: Any, info: Any, args: argparse.Namespace) -> None:
    limit = None if args.full_length else args.truncate_length
    if args.clear:
        print("\x1b[H\x1b[2J")
    if not hasattr(message, "SLOT_TYPES"):  # one field, or raw bytes
        if args.include_message_info:
            print(f"---Got new message, message info:---\n{info}\n---Message data:---")
        print(message, end="\n---\n")
    elif args.csv:
        first = f"{','.join(str(value) for value in info.values())}," if args.include_message_info else ""
        print(first + to_csv(message, limit, args.no_arr, args.no_str))
    else:
        if args.include_message_info:
            print(yaml.dump(info), end="---\n")
        print(to_yaml(message, limit, args.no_arr, args.no_str, args.flow_style), end="---\n")


def _lost(status: Any) -> None:
    print(
        f"A message was lost!!!\n\ttotal count change:{status.total_count_change}\n\ttotal count: {status.total_count}",
        end="---\n",
    )


def _positive(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise argparse.ArgumentTypeError("Expects a floating point number") from None
    if value <= 0:
        raise argparse.ArgumentTypeError("Value must be positive")
    return value


def _unsigned(text: str) -> int:
    if not text.isdigit():
        raise argparse.ArgumentTypeError("value must be an unsigned integer")
    return int(text)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("message_type", nargs="?", help="Type of the ROS message (e.g. 'std_msgs/msg/String')")
    qos.add_arguments(parser, "subscribe", "sensor_data")
    parser.add_argument("--csv", action="store_true", help="Output all recursive fields separated by commas")
    parser.add_argument("--field", help="Echo a selected field of a message. Use '.' to select sub-fields.")
    parser.add_argument("-f", "--full-length", action="store_true", help="Output all elements for arrays and strings")
    parser.add_argument(
        "-l",
        "--truncate-length",
        type=_unsigned,
        default=TRUNCATE_LENGTH,
        help=f"The length to truncate arrays, bytes, and string to (default: {TRUNCATE_LENGTH})",
    )
    parser.add_argument("--no-arr", action="store_true", help="Don't print array fields of messages")
    parser.add_argument("--no-str", action="store_true", help="Don't print string fields of messages")
    parser.add_argument("--flow-style", action="store_true", help="Print collections in the flow style")
    parser.add_argument("--no-lost-messages", action="store_true", help="Don't report when a message is lost")
    parser.add_argument("--raw", action="store_true", help="Echo the raw binary representation")
    parser.add_argument("--filter", dest="filter_expr", help="Python expression over m, the message, to filter by")
    parser.add_argument("--once", action="store_true", help="Print the first message received and then exit.")
    parser.add_argument("--timeout", metavar="N", type=_positive, help="Set a timeout in seconds for waiting")
    parser.add_argument("-i", "--include-message-info", action="store_true", help="Shows the associated message info.")
    parser.add_argument("-c", "--clear", action="store_true", help="Clear screen before printing next message")
    parser.add_argument("-n", "--node-name", help="The name of the echoing node; by default, a hidden node name")
