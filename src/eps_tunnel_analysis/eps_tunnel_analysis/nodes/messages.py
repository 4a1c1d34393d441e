# SPDX-License-Identifier: Apache-2.0
"""Messages: stamps, a verdict, and polled subscriptions."""

import math
from collections.abc import Iterator, Mapping
from typing import Any

from builtin_interfaces.msg import Time
from rclpy.callback_groups import CallbackGroup
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from labyrinth_msgs.msg import Diagnosis
from labyrinth_sim.nodes.start import waiting

# rclpy writes overrides into the profile it is given, so each entity gets a profile of its own.


def reliable(depth: int) -> QoSProfile:
    """A profile for one publisher or subscription; rclpy's overrides change it."""
    return QoSProfile(depth=depth, reliability=ReliabilityPolicy.RELIABLE)


def deep() -> QoSProfile:
    """Reliable, and deep enough for some seconds in which this process is not scheduled."""
    return reliable(1000)


def measured(depth: int) -> QoSProfile:
    """For measurements of which one may be lost; matches reliable and best-effort publishers alike."""
    return QoSProfile(depth=depth, reliability=ReliabilityPolicy.BEST_EFFORT)


def latched() -> QoSProfile:
    """For one value that later subscribers get too."""
    return QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def newest() -> QoSProfile:
    """For values of which only the last counts."""
    return QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)


def nanoseconds(stamp: Time) -> int:
    """ns since the clock's epoch."""
    return stamp.sec * 1_000_000_000 + stamp.nanosec


def to_time(ns: int) -> Time:
    """The stamp of ns since the clock's epoch."""
    return Time(sec=ns // 1_000_000_000, nanosec=ns % 1_000_000_000)


def diagnosis_message(content: Mapping[str, Any], report: str) -> Diagnosis:
    """The content of diagnosis.json as a message without stamp. Errors are those of the model as given, and with the
    named effects; NaN for the latter if none is named."""

    def number(key: str, named: bool = True) -> float:
        value = content[key] if named else None
        return math.nan if value is None else float(value)

    named = content["verdict"] == "effect"
    return Diagnosis(
        verdict=content["verdict"],
        effects=list(content["effects"]),
        candidates=list(content["set"]),
        probabilities=[float(p) for p in content["set"].values()],
        coverage=float(content["coverage"]),
        sentence=content["sentence"],
        error_before=number("error_as_given"),
        error_after=number("error_after", named),
        held_out_before=number("held_out_as_given"),
        held_out_after=number("held_out_after", named),
        alikeness_before=number("alikeness_as_given"),
        alikeness_after=number("alikeness_after", named),
        next_experiment=content["next_experiment"] or "",
        report=report,
    )


class PolledGroup(CallbackGroup):
    """Callback group of subscriptions that no executor waits for."""

    def can_execute(self, entity: object) -> bool:
        return False

    def beginning_execution(self, entity: object) -> bool:
        return False

    def ending_execution(self, entity: object) -> None:
        pass


class PolledTopic:
    """One topic; its depth says how much is kept between two polls."""

    def __init__(self, node: Node, kind: Any, name: str, qos: QoSProfile, group: PolledGroup) -> None:
        # Each event handler is one thing more that the executor waits for.
        silent = SubscriptionEventCallbacks(use_default_callbacks=False)
        self._subscription = node.create_subscription(
            kind, name, lambda _: None, qos, event_callbacks=silent, callback_group=group
        )

    def take(self) -> Iterator[Any]:
        """Messages that came since the last poll, oldest first."""
        return waiting(self._subscription)
