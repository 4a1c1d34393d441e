# SPDX-License-Identifier: Apache-2.0
"""Publishes the messages of bags with the timing of their recording, and /clock."""

import importlib
import re
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import rclpy
from ament_index_python import has_resource
from rclpy.duration import Duration
from rclpy.exceptions import InvalidTopicNameException
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.validate_full_topic_name import validate_full_topic_name
from rosgraph_msgs.msg import Clock
from tqdm import tqdm

from eps_tunnel_analysis.nodes.messages import deep, to_time
from eps_tunnel_analysis.recording.bag import Bag, read_bag
from labyrinth_sim.errors import InputError, unknown_name

TICK = 10_000_000  # ns of recorded time between two messages on /clock
PUBLISHERS_PERIOD = 0.5  # s between two looks for other publishers
ACKNOWLEDGED = 5.0  # s to wait for the last messages to arrive
QUIET = 0.5  # s without new subscribers after which all are taken to be known
NAMED = 2.0  # s to wait for the name of a node whose publisher is known already
MESSAGE_TYPE = re.compile(r"[A-Za-z]\w*/msg/[A-Z]\w*", re.ASCII)
NAMELESS = "_NODE_NAME_UNKNOWN_"  # as rmw reports it


@dataclass(frozen=True)
class Options:
    """speed: 1 is as recorded; most_pause, wait: s; topics: those to publish, empty for all.

    Attributes:
        most_pause: longer pauses of the recording, as between bags, are cut to this; /clock jumps over the rest.
        wait: how long at most subscribers are waited for.
    """

    speed: float = 1.0
    clock: bool = True
    most_pause: float = 5.0
    wait: float = 2.0
    topics: tuple[str, ...] = ()


def replay(paths: Sequence[Path], options: Options) -> str:
    """Publishes all messages of the bags in the order of their log times; returns one sentence on what was published.

    Raises:
        InputError: a bag cannot be read, a topic is not in any, or is published by another node already.
    """
    bags = [read_bag(path) for path in paths]
    kinds = _kinds(bags, options.topics)
    rows = sorted(_rows(bags, kinds), key=lambda row: row[0])
    if not rows:
        raise InputError(f"{', '.join(str(path) for path in paths)}: no messages to publish.")
    rclpy.init(args=[])
    node = rclpy.create_node("replay", start_parameter_services=False)
    try:
        classes, left_out = _classes(kinds)
        publishers = {topic: node.create_publisher(kind, topic, deep()) for topic, kind in classes.items()}
        clock = node.create_publisher(Clock, "/clock", 10) if options.clock else None
        _wait(node, [*publishers.values(), *([clock] if clock else [])], options.wait)
        watched = [*publishers, *(["/clock"] if clock else [])]
        _refuse_others(node, watched)
        _publish(
            [row for row in rows if row[1] in publishers],
            publishers,
            clock,
            options,
            lambda: _refuse_others(node, watched),
        )
        for publisher in publishers.values():
            publisher.wait_for_all_acked(Duration(seconds=ACKNOWLEDGED))
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
    count = sum(topic in publishers for _, topic, _ in rows)
    warning = f" Left out: {', '.join(left_out)}, whose types are not installed here." if left_out else ""
    return f"Published {count} messages on {len(publishers)} topics.{warning}"


def _kinds(bags: Sequence[Bag], asked: Sequence[str]) -> dict[str, str]:
    """Topic -> type name."""
    kinds: dict[str, str] = {}
    complaints = []
    for bag in bags:
        for topic in bag.topics.values():
            if kinds.setdefault(topic.name, topic.type) != topic.type:
                complaints.append(
                    f"{bag.path}: topic '{topic.name}' is a {topic.type}, in an earlier bag a {kinds[topic.name]}."
                )
    complaints += [unknown_name("topic", name, kinds) for name in asked if name not in kinds]
    chosen = {name: kind for name, kind in kinds.items() if not asked or name in asked}
    complaints += [f"A bag's topic {name[:100]!r}: {wrong}. Leave it out by --topics." for name in chosen
                   if (wrong := _illegal(name))]  # fmt: skip
    if complaints:
        raise InputError(complaints)
    return chosen


def _illegal(name: str) -> str:
    """Why ROS takes no such topic; empty where it does."""
    if "\0" in name:  # to rcl the name would end there, and be another one
        return "topic name must not contain NUL"
    try:
        validate_full_topic_name(name)
    except InvalidTopicNameException as error:  # its further lines show the name, which may contain control characters
        return str(error).split("\n")[0].removeprefix("Invalid topic name: ").rstrip(":")
    return ""


def _rows(bags: Sequence[Bag], kinds: Mapping[str, str]) -> Iterator[tuple[int, str, bytes]]:
    """(log time ns, topic, CDR) of all messages."""
    for bag in bags:
        for topic in bag.topics.values():
            if topic.name in kinds and topic.name != "/clock":
                for at, message in zip(topic.log_times, topic.messages, strict=True):
                    yield at, topic.name, bytes(message)


def _classes(kinds: Mapping[str, str]) -> tuple[dict[str, Any], list[str]]:
    """Topic -> message class, and the topics whose type is not installed."""
    classes: dict[str, Any] = {}
    left_out: list[str] = []
    for topic, kind in kinds.items():
        package, _, name = kind.partition("/msg/")
        # A bag may be anybody's: nothing is imported but what is installed as an interface.
        if not (MESSAGE_TYPE.fullmatch(kind) and has_resource("rosidl_interfaces", package)):
            left_out.append(f"{topic} ({kind})")
            continue
        try:
            classes[topic] = getattr(importlib.import_module(f"{package}.msg"), name)
        except (ImportError, AttributeError):
            left_out.append(f"{topic} ({kind})")
    classes.pop("/clock", None)
    return classes, left_out


def _wait(node: Node, publishers: Sequence[Publisher], longest: float) -> None:
    """Until every topic but /clock has a subscriber, all known ones are matched, and no more appear."""
    began = changed = time.monotonic()
    seen: list[int] = []
    while (now := time.monotonic()) - began < longest:
        reached = [publisher.get_subscription_count() for publisher in publishers]
        known = [node.count_subscribers(publisher.topic_name) for publisher in publishers]
        if reached + known != seen:
            seen, changed = reached + known, now
        listened = all(count or p.topic_name == "/clock" for count, p in zip(reached, publishers, strict=True))
        if listened and reached == known and now - changed > QUIET:
            return
        time.sleep(0.02)


def _refuse_others(node: Node, topics: Sequence[str]) -> None:
    """A rig must not get recorded commands, and an analysis must not get two measurements at once."""
    # One publisher of each topic is this node's. Others' are known before the names of their nodes.
    deadline = time.monotonic() + NAMED
    while True:
        publishers = {topic: node.get_publishers_info_by_topic(topic) for topic in topics}
        publishers = {topic: infos for topic, infos in publishers.items() if len(infos) > 1}
        named = all(info.node_name != NAMELESS for infos in publishers.values() for info in infos)
        if named or time.monotonic() > deadline:
            break
        time.sleep(0.02)
    complaints = []
    for topic, infos in publishers.items():
        full = [f"{info.node_namespace.rstrip('/')}/{info.node_name}" for info in infos]
        others = {name for name in full if name != node.get_fully_qualified_name() and NAMELESS not in name}
        complaints.append(
            f"{topic} is published by {', '.join(sorted(others)) or 'another node'} already. Stop that, leave the "
            "topic out by --topics, or set another ROS_DOMAIN_ID."
        )
    if complaints:
        raise InputError(complaints)


def _publish(
    rows: Sequence[tuple[int, str, bytes]],
    publishers: Mapping[str, Publisher],
    clock: Publisher | None,
    options: Options,
    check: Callable[[], None],
) -> None:
    """Publishes each row when its time has come, and calls `check` now and then: others may be found late."""
    pause = round(options.most_pause * 1e9)
    now, played, next_tick = rows[0][0], 0, rows[0][0]  # ns of the recording; ns of it that were played
    length = sum(min(two[0] - one[0], pause) for one, two in pairwise(rows))
    began = time.monotonic()
    next_check = began + PUBLISHERS_PERIOD
    with tqdm(total=round(length * 1e-9, 1), unit="s", desc="replay", disable=None) as bar:
        for at, topic, message in rows:
            played += min(at - now, pause)
            next_tick = at if at - now > pause else next_tick
            now = at
            delay = began + played * 1e-9 / options.speed - time.monotonic()
            if delay > 0:
                time.sleep(delay)
            if clock is not None and at >= next_tick:
                clock.publish(Clock(clock=to_time(at)))
                next_tick = at + TICK
                bar.update(round(played * 1e-9, 1) - bar.n)
            publishers[topic].publish(message)
            if time.monotonic() > next_check:
                check()
                next_check = time.monotonic() + PUBLISHERS_PERIOD
