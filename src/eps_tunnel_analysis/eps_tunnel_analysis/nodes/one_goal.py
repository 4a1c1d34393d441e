# SPDX-License-Identifier: Apache-2.0
"""An action server that works on one goal at a time, in a thread of its own, while its node goes on."""

import threading
from collections.abc import Callable
from typing import Any, TypeAlias

from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle

from eps_tunnel_analysis.nodes.common import TunnelNode

Handle: TypeAlias = ServerGoalHandle[Any, Any, Any]


class OneGoal:
    """Takes a goal when nothing is under way, and refuses it otherwise.

    Args:
        kind, name: of the action.
        refusal: what to tell of a goal that is refused.
        work: does a goal; ends with `handle.execute` of what calls `settle`.
    """

    def __init__(
        self, node: TunnelNode, kind: Any, name: str, refusal: Callable[[Any], str], work: Callable[[Handle], None]
    ) -> None:
        self._node, self._refusal, self._name = node, refusal, name.strip("/")
        self._working = threading.Lock()
        self._thread: threading.Thread | None = None
        self._server = ActionServer(
            node, kind, name, lambda _: kind.Result(), goal_callback=self._goal,
            handle_accepted_callback=lambda handle: self._start(lambda: work(handle)),
            cancel_callback=lambda _: CancelResponse.ACCEPT,
        )  # fmt: skip

    @property
    def busy(self) -> bool:
        """While something is under way."""
        return self._working.locked()

    def begin(self, work: Callable[[], None]) -> bool:
        """Does something without a goal, which calls `free` at its end; False where something is under way."""
        if not self._working.acquire(blocking=False):
            return False
        self._start(work)
        return True

    def stopped(self, handle: Handle) -> bool:
        """Whether a goal is to end early."""
        return bool(handle.is_cancel_requested) or self._node.stopping.is_set()

    def settle(self, handle: Handle, success: bool) -> None:
        """Brings a goal to its end, and takes the next one."""
        try:
            if success:
                handle.succeed()
            elif handle.is_cancel_requested:
                handle.canceled()
            else:
                handle.abort()
        finally:
            self.free()

    def free(self) -> None:
        """Takes the next goal."""
        self._working.release()

    def close(self) -> None:
        """Waits for the end of what is under way; `node.stopping` calls it off."""
        self._server.destroy()
        if self._thread is not None:
            self._thread.join()

    def _goal(self, goal: Any) -> GoalResponse:
        if self._node.stopping.is_set() or not self._working.acquire(blocking=False):
            self._node.get_logger().warning(self._refusal(goal))
            return GoalResponse.REJECT
        return GoalResponse.ACCEPT

    def _start(self, work: Callable[[], None]) -> None:
        # A thread of its own: a blocking callback would need a multi-threaded executor, which takes twice the time of
        # this one for every message that comes in.
        self._thread = threading.Thread(target=work, name=self._name)
        self._thread.start()
