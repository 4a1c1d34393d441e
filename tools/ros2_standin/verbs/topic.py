# SPDX-License-Identifier: Apache-2.0
"""Various topic related sub-commands"""

import argparse
import functools
import time
from collections.abc import Callable
from typing import Any

import rclpy
from rclpy.expand_topic_name import expand_topic_name
from rclpy.node import Node
from rclpy.validate_full_topic_name import validate_full_topic_name

from ros2_standin import graph
from ros2_standin.messages import INVALID, interface
from ros2_standin.verbs import add_verbs, topic_echo, topic_hz, topic_pub

NAME = "topic"
UNKNOWN = "_UNKNOWN_"


def names_and_types(node: Node, include_hidden: bool) -> list[tuple[str, list[str]]]:
    return [pair for pair in node.get_topic_names_and_types() if include_hidden or not graph.hidden(pair[0])]


def message_class(node: Node, topic: str, wait: bool = False) -> Any:
    """The class of a topic's messages; None when nobody publishes it and `wait` is false."""
    if not graph.wait_for(lambda: _message_class(node, topic) is not None):
        print(f"WARNING: topic [{topic}] does not appear to be published yet")
        while wait and _message_class(node, topic) is None:
            time.sleep(0.1)
    return _message_class(node, topic)


def _message_class(node: Node, topic: str) -> Any:
    try:
        full = expand_topic_name(topic, node.get_name(), node.get_namespace())
        validate_full_topic_name(full)
    except (ValueError, rclpy.exceptions.InvalidTopicNameException) as error:
        raise RuntimeError(error) from None
    types = dict(names_and_types(node, include_hidden=True)).get(full)
    if types is None:
        return None
    if len(types) > 1:
        raise RuntimeError(f"Cannot echo topic '{topic}', as it contains more than one type: [{', '.join(types)}]")
    try:
        return interface(types[0], "msg")
    except INVALID:
        raise RuntimeError(f"The message type '{types[0]}' is invalid") from None


def _types_of(node: Node, topic: str) -> list[str] | None:
    graph.wait_for(lambda: topic in dict(names_and_types(node, include_hidden=True)))
    return dict(names_and_types(node, include_hidden=True)).get(topic)


def list_(args: argparse.Namespace) -> None:
    """Output a list of available topics"""
    with graph.direct_node(args) as node:
        pairs = names_and_types(node, args.include_hidden_topics)
        counts = [(node.count_publishers(name), node.count_subscribers(name)) for name, _ in pairs]
    if not args.verbose or args.count_topics:
        graph.print_names(pairs, args.show_types, args.count_topics)
        return
    for column, (title, noun) in enumerate((("Published", "publisher"), ("Subscribed", "subscriber"))):
        print(f"{title} topics:")
        for (name, types), count in zip(pairs, (row[column] for row in counts), strict=True):
            if count:
                print(f" * {name} [{', '.join(types)}] {count} {noun}{'s' if count > 1 else ''}")
        print()


def info(args: argparse.Namespace) -> str | None:
    """Print information about a topic"""
    with graph.direct_node(args) as node:
        types = _types_of(node, args.topic_name)
        if types is None:
            return f"Unknown topic '{args.topic_name}'"
        end = "\n\n" if args.verbose else "\n"
        print(f"Type: {types[0] if len(types) == 1 else types}", end=end)
        for title, count, endpoints in (
            ("Publisher", node.count_publishers, node.get_publishers_info_by_topic),
            ("Subscription", node.count_subscribers, node.get_subscriptions_info_by_topic),
        ):
            print(f"{title} count: {count(args.topic_name)}", end=end)
            if args.verbose:
                # An end is known before the name of its node.
                graph.wait_for(functools.partial(_named, endpoints, args.topic_name))
                for endpoint in endpoints(args.topic_name):
                    print(endpoint, end=end)
    return None


def _named(endpoints: Callable[[str], Any], topic: str) -> bool:
    return all(UNKNOWN not in endpoint.node_name for endpoint in endpoints(topic))


def type_(args: argparse.Namespace) -> int | None:
    """Print a topic's type"""
    with graph.direct_node(args) as node:
        types = _types_of(node, args.topic_name)
    if types is None:
        return 1
    print("\n".join(types))
    return None


def echo(args: argparse.Namespace) -> None:
    """Output messages from a topic"""
    with graph.direct_node(args, args.node_name) as node:
        if args.message_type is None:
            kind = message_class(node, args.topic_name)
        else:
            try:
                kind = interface(args.message_type, "msg")
            except INVALID:
                raise RuntimeError("The passed message type is invalid") from None
        if kind is None:
            raise RuntimeError("Could not determine the type for the passed topic")
        topic_echo.echo(node, kind, args)


def hz(args: argparse.Namespace) -> None:
    """Print the average publishing rate to screen"""
    with graph.direct_node(args) as node:
        topic_hz.hz(node, {topic: message_class(node, topic, wait=True) for topic in args.topic_name}, args)


def pub(args: argparse.Namespace) -> str | None:
    """Publish a message to a topic"""
    with graph.direct_node(args, args.node_name) as node:
        return topic_pub.pub(node, args)


def _topic_name(parser: argparse.ArgumentParser, purpose: str, **options: Any) -> None:
    parser.add_argument("topic_name", help=f"{purpose} (e.g. '/chatter')", **options)


def _list_arguments(parser: argparse.ArgumentParser) -> None:
    graph.add_arguments(parser)
    parser.add_argument("-t", "--show-types", action="store_true", help="Additionally show the topic type")
    parser.add_argument(
        "-c", "--count-topics", action="store_true", help="Only display the number of topics discovered"
    )
    _hidden_argument(parser)
    parser.add_argument("-v", "--verbose", action="store_true", help="List full details about each topic")


def _hidden_argument(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--include-hidden-topics",
        action="store_true",
        # Given before the verb it must survive the verb's own parser.
        default=argparse.SUPPRESS,
        help="Consider hidden topics as well",
    )


def _info_arguments(parser: argparse.ArgumentParser) -> None:
    graph.add_arguments(parser)
    _topic_name(parser, "Name of the ROS topic to get info")
    parser.add_argument(
        "-v", "--verbose", action="store_true", help="Prints node names, type, GUID and QoS of each end"
    )


def _type_arguments(parser: argparse.ArgumentParser) -> None:
    graph.add_arguments(parser)
    _topic_name(parser, "Name of the ROS topic to get type")
    _hidden_argument(parser)


def _echo_arguments(parser: argparse.ArgumentParser) -> None:
    graph.add_arguments(parser)
    _topic_name(parser, "Name of the ROS topic to listen to")
    topic_echo.add_arguments(parser)


def _hz_arguments(parser: argparse.ArgumentParser) -> None:
    _topic_name(parser, "Names of the ROS topic to listen to", nargs="+")
    topic_hz.add_arguments(parser)
    graph.add_arguments(parser, daemon=False)


def _pub_arguments(parser: argparse.ArgumentParser) -> None:
    _topic_name(parser, "Name of the ROS topic to publish to")
    topic_pub.add_arguments(parser)
    graph.add_arguments(parser, daemon=False)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--include-hidden-topics", action="store_true", help="Consider hidden topics as well")
    add_verbs(
        parser,
        NAME,
        {
            "echo": (echo, _echo_arguments),
            "hz": (hz, _hz_arguments),
            "info": (info, _info_arguments),
            "list": (list_, _list_arguments),
            "pub": (pub, _pub_arguments),
            "type": (type_, _type_arguments),
        },
    )
