# SPDX-License-Identifier: Apache-2.0
"""Fits a model to recorded bags when asked over ROS."""

import sys
import threading
from typing import Any

from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle

from eps_tunnel_analysis.fit.process import Ended, Told, run_calibration
from eps_tunnel_analysis.nodes.common import TunnelNode, run_node
from labyrinth_msgs.action import Calibrate


class CalibrateNode(TunnelNode):
    """Action server /calibrate; the fit runs in a process of its own, as `eps-tunnel calibrate`."""

    def __init__(self) -> None:
        super().__init__("calibrate_node")
        self._signals = [s for s in self.parameter("signals", [""], "Signals to fit; empty: every position") or [] if s]
        self.check_parameters()
        self._working = threading.Lock()
        self._thread: threading.Thread | None = None
        self._server = ActionServer(
            self, Calibrate, "/calibrate", lambda _: Calibrate.Result(), goal_callback=self._goal,
            handle_accepted_callback=self._accepted, cancel_callback=lambda _: CancelResponse.ACCEPT,
        )  # fmt: skip

    @property
    def busy(self) -> bool:
        return self._working.locked()

    def close(self) -> None:
        self._server.destroy()
        if self._thread is not None:
            self._thread.join()

    def _goal(self, goal: Calibrate.Goal) -> GoalResponse:
        if self.stopping.is_set() or not self._working.acquire(blocking=False):
            self.get_logger().warning(f"Refused to calibrate '{goal.model}': another calibration is under way.")
            return GoalResponse.REJECT
        return GoalResponse.ACCEPT

    def _accepted(self, handle: ServerGoalHandle[Any, Any, Any]) -> None:
        self._thread = threading.Thread(target=self._work, args=(handle,), name="calibrate")
        self._thread.start()

    def _work(self, handle: ServerGoalHandle[Any, Any, Any]) -> None:
        def tell(told: Told) -> None:
            handle.publish_feedback(
                Calibrate.Feedback(progress=told.share, best=told.best, evaluations=told.evaluations)
            )

        try:
            ended = run_calibration(
                arguments(handle.request, self._signals), tell,
                lambda: handle.is_cancel_requested or self.stopping.is_set(),
            )  # fmt: skip
        except Exception as error:  # a thread that died silently would leave the node busy for ever
            ended = Ended(False, f"The calibration failed: {error!r}.", {})
        if ended.success:  # rclpy knows a call by its line, and allows each one severity
            self.get_logger().info(ended.message)
        else:
            self.get_logger().error(ended.message)
        handle.execute(lambda h: self._finish(h, ended))

    def _finish(self, handle: ServerGoalHandle[Any, Any, Any], ended: Ended) -> Calibrate.Result:
        try:
            if ended.success:
                handle.succeed()
            elif handle.is_cancel_requested:
                handle.canceled()
            else:
                handle.abort()
        finally:
            self._working.release()
        return result(ended)


def arguments(goal: Calibrate.Goal, signals: list[str]) -> list[str]:
    """A goal as the command line takes it."""
    given = ["--real", *goal.bags, "--model", goal.model, "--out", goal.out, "--seed", str(goal.seed)]
    given += ["--method", goal.method] if goal.method else []
    given += ["--fitness", goal.fitness] if goal.fitness else []
    return given + (["--signals", *signals] if signals else [])


def result(ended: Ended) -> Calibrate.Result:
    """The end of a fit as a message: errors are equation 11's over the fitted commands, all signals together."""
    told = Calibrate.Result(success=ended.success, message=ended.message)
    if ended.content:
        plays = len(ended.content["plays"]) - len({p for f in ended.content["fits"] for p in f["held_out_plays"]})
        sums = [
            plays * sum(score["error"] if score["error"] is not None else float("inf") for score in scores)
            for scores in (ended.content["scores"]["before"], ended.content["scores"]["after"])
        ]
        told.file, told.error_before, told.error_after = ended.content["out"], float(sums[0]), float(sums[1])
    return told


def main(args: list[str] | None = None) -> int:
    """Entry point of `ros2 run eps_tunnel_analysis calibrate_node`."""
    return run_node(CalibrateNode, args)


if __name__ == "__main__":
    sys.exit(main())
