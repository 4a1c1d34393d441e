# SPDX-License-Identifier: Apache-2.0
"""Fits a model to recorded bags when asked over ROS."""

import sys
from typing import Any

from eps_tunnel_analysis.nodes.common import Handle, OneGoal, TunnelNode, attempted, run_node
from eps_tunnel_analysis.processes import CommandResult
from eps_tunnel_analysis.tasks import CalibrateTask, run_task
from labyrinth_msgs.action import Calibrate
from labyrinth_sim.config import typed_path


class CalibrateNode(TunnelNode):
    """Action server calibrate; the fit runs in a separate process, like that of `eps-tunnel calibrate`."""

    def __init__(self) -> None:
        super().__init__("calibrate_node")
        self.parameter("signals", [""], "Signals to fit; empty: every position", changes=True)
        self.check_parameters()
        self._goals = OneGoal(
            self, Calibrate, "calibrate",
            lambda goal: f"Refused to calibrate '{goal.model}': another calibration is under way.", self._work,
        )  # fmt: skip

    @property
    def busy(self) -> bool:
        return self._goals.busy

    def close(self) -> None:
        self._goals.close()

    def _work(self, handle: Handle) -> None:
        def publish(progress: dict[str, Any]) -> None:
            count = progress["evaluations"]
            handle.publish_feedback(
                Calibrate.Feedback(progress=count / progress["of"], best=progress["best"], evaluations=count)
            )

        def fit() -> Calibrate.Result:
            signals = [name for name in self.get_parameter("signals").value or [] if name]
            task = calibrate_task(handle.request, signals)
            return result(run_task(task, publish, lambda: self._goals.stopped(handle)))

        answer = attempted("calibration", fit, lambda message: Calibrate.Result(success=False, message=message))
        self.say(answer.success, answer.message)
        handle.execute(lambda h: self._finish(h, answer))

    def _finish(self, handle: Handle, answer: Calibrate.Result) -> Calibrate.Result:
        self._goals.settle(handle, answer.success)
        return answer


def calibrate_task(goal: Calibrate.Goal, signals: list[str]) -> CalibrateTask:
    """A goal as a task. Raises pydantic's ValidationError."""
    chosen = {key: value for key, value in (("method", goal.method), ("fitness", goal.fitness)) if value}
    return CalibrateTask(
        bags=tuple(map(typed_path, goal.bags)), model=goal.model, out=typed_path(goal.out), seed=goal.seed,
        signals=tuple(signals), **chosen,
    )  # fmt: skip


def result(ended: CommandResult) -> Calibrate.Result:
    """The end of a fit as a message: errors are equation 11's over the fitted commands, all signals together."""
    content = ended.content
    if content is None:
        return Calibrate.Result(success=False, message=ended.complaint)
    values = ", ".join(f"{name} = {value:.6g}" for name, value in content["values"].items())
    message = f"{'Interrupted; the best so far: ' if content['interrupted'] else ''}{values}."
    answer = Calibrate.Result(success=not content["interrupted"], message=message, file=content["out"])
    plays = len(content["plays"]) - len({p for f in content["fits"] for p in f["held_out_plays"]})
    sums = [
        plays * sum(score["error"] if score["error"] is not None else float("inf") for score in scores)
        for scores in (content["scores"]["before"], content["scores"]["after"])
    ]
    answer.error_before, answer.error_after = float(sums[0]), float(sums[1])
    return answer


def main(args: list[str] | None = None) -> int:
    """Entry point of `ros2 run eps_tunnel_analysis calibrate_node`."""
    return run_node("calibrate_node", "Fits a model to recorded bags when asked over ROS.", CalibrateNode, args)


if __name__ == "__main__":
    sys.exit(main())
