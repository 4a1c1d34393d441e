# SPDX-License-Identifier: Apache-2.0
"""Subscriptions that are looked at now and then; a wake-up per message takes several times the processor."""

from collections.abc import Iterator
from typing import Any

from rclpy.callback_groups import CallbackGroup
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import QoSProfile

from labyrinth_sim.nodes.waiting import waiting


class PolledGroup(CallbackGroup):
    """Of subscriptions that no executor waits for."""

    def can_execute(self, entity: object) -> bool:
        return False

    def beginning_execution(self, entity: object) -> bool:
        return False

    def ending_execution(self, entity: object) -> None:
        pass


class PolledTopic:
    """One topic; its depth says how much is kept between two looks."""

    def __init__(self, node: Node, kind: Any, name: str, qos: QoSProfile, group: PolledGroup) -> None:
        # Each event handler is one thing more that the executor waits for.
        silent = SubscriptionEventCallbacks(use_default_callbacks=False)
        self._subscription = node.create_subscription(
            kind, name, lambda _: None, qos, event_callbacks=silent, callback_group=group
        )

    def take(self) -> Iterator[Any]:
        """Messages that came since the last look, oldest first."""
        return waiting(self._subscription)
