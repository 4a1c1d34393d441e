# SPDX-License-Identifier: Apache-2.0
"""What publishers offer: their quality of service, the profile that hears all of them, and how a bag tells it."""

from collections.abc import Sequence
from typing import Any

from rclpy.node import Node
from rclpy.qos import (
    DurabilityPolicy,
    QoSCompatibility,
    QoSPolicyKind,
    QoSProfile,
    ReliabilityPolicy,
    qos_check_compatible,
)
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime

ADAPTED = (QoSPolicyKind.RELIABILITY, QoSPolicyKind.DURABILITY)
SIZES = (QoSPolicyKind.HISTORY, QoSPolicyKind.DEPTH)
LONGEST = 2**63 - 1  # ns; what rosbag2 writes for "for ever"


def offered(node: Node, topic: str) -> list[QoSProfile]:
    """The profile of each publisher of a topic, by its full name."""
    return [end.qos_profile for end in node.get_publishers_info_by_topic(topic)]


def hears_all(profiles: Sequence[QoSProfile], depth: int) -> QoSProfile:
    """A subscription's profile that every one of some publishers matches: as strict as the least strict of them."""
    reliable = all(p.reliability != ReliabilityPolicy.BEST_EFFORT for p in profiles)
    latched = bool(profiles) and all(p.durability == DurabilityPolicy.TRANSIENT_LOCAL for p in profiles)
    return QoSProfile(
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


def hears(subscription: QoSProfile, publisher: QoSProfile) -> bool:
    """Whether a subscription with one profile hears a publisher with another."""
    return qos_check_compatible(publisher, subscription)[0] != QoSCompatibility.ERROR


def overridden(node: Node, topic: str) -> dict[QoSPolicyKind, Any]:
    """Policies that parameters `qos_overrides.TOPIC.subscription.POLICY` fix, with their values as given."""
    given = node._parameter_overrides
    names = {policy: f"qos_overrides.{topic}.subscription.{policy.name.lower()}" for policy in (*SIZES, *ADAPTED)}
    return {policy: given[name].value for policy, name in names.items() if name in given}


def as_in_bags(profile: QoSProfile) -> Qos:
    """A publisher's profile as metadata.yaml tells it."""

    def time(nanoseconds: int) -> QosTime:
        return QosTime(*divmod(min(nanoseconds, LONGEST), 10**9))

    return Qos(
        QosHistory[profile.history.name],
        profile.depth,
        QosReliability[profile.reliability.name],
        QosDurability[profile.durability.name],
        time(profile.deadline.nanoseconds),
        time(profile.lifespan.nanoseconds),
        QosLiveliness[profile.liveliness.name],
        time(profile.liveliness_lease_duration.nanoseconds),
        bool(profile.avoid_ros_namespace_conventions),
    )
