# SPDX-License-Identifier: Apache-2.0
"""Quality of service: from command line options, or to match the publishers that are there."""

import argparse
from collections.abc import Sequence
from typing import Any

from rclpy.node import Node
from rclpy.qos import (
    QoSDurabilityPolicy,
    QoSHistoryPolicy,
    QoSPresetProfiles,
    QoSProfile,
    QoSReliabilityPolicy,
)

OVERRIDES = ("depth", "history", "reliability", "durability")


def add_arguments(parser: argparse.ArgumentParser, verb: str, default: str) -> None:
    parser.add_argument(
        "--qos-profile",
        choices=QoSPresetProfiles.short_keys(),
        default=default,
        help=f"Quality of service preset profile to {verb} with (default: {default})",
    )
    parser.add_argument("--qos-depth", metavar="N", type=int, help=f"Queue size setting to {verb} with")
    for name, policy in (
        ("history", QoSHistoryPolicy),
        ("reliability", QoSReliabilityPolicy),
        ("durability", QoSDurabilityPolicy),
    ):
        parser.add_argument(
            f"--qos-{name}",
            choices=policy.short_keys(),
            help=f"Quality of service {name} setting to {verb} with (overrides {name} value of --qos-profile option)",
        )


def from_arguments(args: argparse.Namespace) -> QoSProfile:
    profile = QoSPresetProfiles.get_from_short_key(args.qos_profile)
    if args.qos_history:
        profile.history = QoSHistoryPolicy.get_from_short_key(args.qos_history)
    if args.qos_durability:
        profile.durability = QoSDurabilityPolicy.get_from_short_key(args.qos_durability)
    if args.qos_reliability:
        profile.reliability = QoSReliabilityPolicy.get_from_short_key(args.qos_reliability)
    if args.qos_depth and args.qos_depth >= 0:
        profile.depth = args.qos_depth
    elif profile.durability == QoSDurabilityPolicy.TRANSIENT_LOCAL and profile.depth == 0:
        profile.depth = 1
    return profile


def matching(node: Node, topic: str, args: argparse.Namespace) -> QoSProfile:
    """A profile that every publisher of the topic serves, latched ones included, unless options say otherwise."""
    if any(getattr(args, f"qos_{name}") is not None for name in OVERRIDES):
        return from_arguments(args)
    profile = QoSPresetProfiles.get_from_short_key(args.qos_profile)
    offered = [info.qos_profile for info in node.get_publishers_info_by_topic(topic)]
    if offered:
        profile.reliability = _common(
            [o.reliability for o in offered], QoSReliabilityPolicy.RELIABLE, QoSReliabilityPolicy.BEST_EFFORT
        )
        profile.durability = _common(
            [o.durability for o in offered], QoSDurabilityPolicy.TRANSIENT_LOCAL, QoSDurabilityPolicy.VOLATILE
        )
    return profile


def _common(offered: Sequence[Any], strong: Any, weak: Any) -> Any:
    """The strong policy where all offer it, else the weak one, saying so where some do."""
    count = sum(policy == strong for policy in offered)
    if count == len(offered):
        return strong
    if count:
        kind = type(strong).__name__
        print(
            f"Some, but not all, publishers are offering {kind}.{strong.name}. Falling back to {kind}.{weak.name} "
            "as it will connect to all publishers"
        )
    return weak
