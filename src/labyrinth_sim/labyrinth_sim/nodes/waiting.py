# SPDX-License-Identifier: Apache-2.0
"""What waits in a subscription, taken at once; an executor takes one message at a time."""

from collections.abc import Iterator
from typing import Any

from rclpy.subscription import Subscription


def waiting(subscription: Subscription) -> Iterator[Any]:
    """Messages that came since the last look, oldest first."""
    with subscription.handle:
        while (taken := subscription.handle.take_message(subscription.msg_type, False)) is not None:
            yield taken[0]
