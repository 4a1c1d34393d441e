# SPDX-License-Identifier: Apache-2.0
"""Fits a model to recorded bags when asked over ROS."""

import sys

from eps_tunnel_analysis.fit.process import Ended, Told, run_calibration
from eps_tunnel_analysis.nodes.common import TunnelNode, run_node
from eps_tunnel_analysis.nodes.one_goal import Handle, OneGoal
from labyrinth_msgs.action import Calibrate


class CalibrateNode(TunnelNode):
    """Action server /calibrate; the fit runs in a process of its own, as `eps-tunnel calibrate`."""

    def __init__(self) -> None:
        super().__init__("calibrate_node")
        self._signals = [s for s in self.parameter("signals", [""], "Signals to fit; empty: every position") or [] if s]
        self.check_parameters()
        self._goals = OneGoal(
            self, Calibrate, "/calibrate",
            lambda goal: f"Refused to calibrate '{goal.model}': another calibration is under way.", self._work,
        )  # fmt: skip

    @property
    def busy(self) -> bool:
        return self._goals.busy

    def close(self) -> None:
        self._goals.close()

    def _work(self, handle: Handle) -> None:
        def tell(told: Told) -> None:
            handle.publish_feedback(
                Calibrate.Feedback(progress=told.share, best=told.best, evaluations=told.evaluations)
            )

        try:
            ended = run_calibration(arguments(handle.request, self._signals), tell, lambda: self._goals.stopped(handle))
        except Exception as error:  # a thread that died silently would leave the node busy for ever
            ended = Ended(False, f"The calibration failed: {error!r}.", {})
        if ended.success:  # rclpy knows a call by its line, and allows each one severity
            self.get_logger().info(ended.message)
        else:
            self.get_logger().error(ended.message)
        handle.execute(lambda h: self._finish(h, ended))

    def _finish(self, handle: Handle, ended: Ended) -> Calibrate.Result:
        self._goals.settle(handle, ended.success)
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
