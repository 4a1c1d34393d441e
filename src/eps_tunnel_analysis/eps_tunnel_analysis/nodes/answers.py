# SPDX-License-Identifier: Apache-2.0
"""Answers of a server that has only just been found.

A client that finds a server may ask before the server has found the client. The answer is then lost, and the client
would wait for it for good.
"""

import time
import uuid
from typing import Any

from action_msgs.srv import CancelGoal
from rclpy.node import Node

ASK_AGAIN = 3.0  # s without an answer until the request is sent again


class Repeated:
    """A request that may be carried out more than once; it is sent again until it is answered.

    Args:
        client: of a service that is ready.
    """

    def __init__(self, client: Any, request: Any) -> None:
        self._client, self._request = client, request
        self._futures: list[Any] = []
        self._due = time.monotonic()

    def done(self) -> bool:
        """Whether an answer has come. To be called while the node spins; sends what is due."""
        if any(future.done() for future in self._futures):
            return True
        if time.monotonic() >= self._due:
            self._futures.append(self._client.call_async(self._request))
            self._due = time.monotonic() + ASK_AGAIN
        return False

    def result(self) -> Any:
        """The first answer; ValueError before one has come."""
        for future in self._futures:
            if future.done():
                return future.result()
        raise ValueError("no answer yet")


class Meeting:
    """Whether an action's server and a client of it have found each other.

    Endpoints are made known in the order in which they were made. An answer to a client that was made later therefore
    shows that the server knows the earlier ones. The request cancels a goal that does not exist.

    Args:
        node, client: whose client it is, and the client of the action of this name.
    """

    def __init__(self, node: Node, client: Any, action: str) -> None:
        self._action_client = client
        self._client: Any = node.create_client(CancelGoal, f"{action}/_action/cancel_goal")
        self._nobody = CancelGoal.Request()
        self._nobody.goal_info.goal_id.uuid = list(uuid.uuid4().bytes)
        self._asked: Repeated | None = None

    def done(self) -> bool:
        """Whether they have met; a server that went and came back is met anew. To be called while the node spins."""
        if not (self._action_client.server_is_ready() and self._client.service_is_ready()):
            self._asked = None
        elif self._asked is None:
            self._asked = Repeated(self._client, self._nobody)
        return self._asked is not None and self._asked.done()
