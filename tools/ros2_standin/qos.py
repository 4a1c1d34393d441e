# SPDX-License-Identifier: Apache-2.0
"""Quality of service: from command line options, or to match the publishers that are there."""

import argparse
from collections.abc import Sequence
from typing import Any

from rclpy.node import Node
from rclpy.qos import QoSDurabilityPolicy, QoSPresetProfiles, QoSProfile, QoSReliabilityPolicy

from ros2_standin.cli import Argument, argument

POLICIES = {"reliability": QoSReliabilityPolicy, "durability": QoSDurabilityPolicy}


def options(default: str) -> list[Argument]:
    """Arguments of a verb whose default profile is `default`."""
    presets = QoSPresetProfiles.short_keys()
    return [
        argument("--qos-profile", choices=presets, default=default, help="Preset profile (default: %(default)s)"),
        argument("--qos-depth", metavar="N", type=int, help="Queue size"),
        *(
            argument(f"--qos-{name}", choices=policy.short_keys(), help=f"Overrides the profile's {name}")
            for name, policy in POLICIES.items()
        ),
    ]


def from_options(args: argparse.Namespace) -> QoSProfile:
    profile = QoSPresetProfiles.get_from_short_key(args.qos_profile)
    for name, policy in POLICIES.items():
        if given := getattr(args, f"qos_{name}"):
            setattr(profile, name, policy.get_from_short_key(given))
    if args.qos_depth:
        profile.depth = args.qos_depth
    elif profile.durability == QoSDurabilityPolicy.TRANSIENT_LOCAL and profile.depth == 0:
        profile.depth = 1
    return profile


def matching(node: Node, topic: str, args: argparse.Namespace) -> QoSProfile:
    """A profile that every publisher of the topic serves, latched ones included, unless options say otherwise."""
    profile = from_options(args)
    offered = [info.qos_profile for info in node.get_publishers_info_by_topic(topic)]
    if offered and not (args.qos_depth or args.qos_reliability or args.qos_durability):
        reliable, best_effort = QoSReliabilityPolicy.RELIABLE, QoSReliabilityPolicy.BEST_EFFORT
        latched, volatile = QoSDurabilityPolicy.TRANSIENT_LOCAL, QoSDurabilityPolicy.VOLATILE
        profile.reliability = _common([o.reliability for o in offered], reliable, best_effort)
        profile.durability = _common([o.durability for o in offered], latched, volatile)
    return profile


def _common(offered: Sequence[Any], strong: Any, weak: Any) -> Any:
    """The strong policy where all offer it, else the weak one, saying so where some do."""
    count = sum(policy == strong for policy in offered)
    if 0 < count < len(offered):
        kind = type(strong).__name__
        print(
            f"Some, but not all, publishers are offering {kind}.{strong.name}. Falling back to {kind}.{weak.name} "
            "as it will connect to all publishers"
        )
    return strong if count == len(offered) else weak
