# SPDX-License-Identifier: Apache-2.0
"""Diagnoses on request, in a process of its own, so that the live figures go on."""

import math
from typing import Any

from eps_tunnel_analysis.nodes.common import Handle, OneGoal, TunnelNode
from eps_tunnel_analysis.nodes.messages import diagnosis_message, latched
from eps_tunnel_analysis.tasks import DiagnoseTask, run_task
from labyrinth_msgs.action import Diagnose
from labyrinth_msgs.msg import Diagnosis
from labyrinth_sim.config import typed_path


class DiagnoseServer:
    """Action server /diagnose of a node, and its latched topic /srg/diagnosis."""

    def __init__(self, node: TunnelNode) -> None:
        self._node = node
        self._verdicts = node.create_publisher(Diagnosis, "srg/diagnosis", latched())
        self._goals = OneGoal(
            node, Diagnose, "diagnose",
            lambda goal: f"Refused to diagnose '{goal.model}': another diagnosis is under way.", self._work,
        )  # fmt: skip

    @property
    def busy(self) -> bool:
        """While a diagnosis runs."""
        return self._goals.busy

    def close(self) -> None:
        """Waits for the end of what runs; `node.stopping` calls it off."""
        self._goals.close()

    def _work(self, handle: Handle) -> None:
        def publish(progress: dict[str, Any]) -> None:
            done, of = int(progress["rollouts"]), int(progress["of"])
            stage = f"{progress['doing']}, {done:,} roll-outs"
            share = done / of if of else 0.0
            handle.publish_feedback(Diagnose.Feedback(progress=share, best=math.nan, stage=stage))

        goal: Diagnose.Goal = handle.request
        content: dict[str, Any] = {}
        try:
            result = run_task(diagnose_task(goal), publish, lambda: self._goals.stopped(handle))
            content, message = result.content or {}, "" if result.content else result.complaint
        except Exception as error:  # a thread that died silently would leave the node busy for ever
            message = f"The diagnosis failed: {error!r}."
        handle.execute(lambda h: self._finish(h, content, message))

    def _finish(self, handle: Handle, content: dict[str, Any], message: str) -> Diagnose.Result:
        result = Diagnose.Result(success=bool(content), message=message)
        try:
            if content:
                out = diagnose_task(handle.request).out
                result.message, result.file = content["sentence"], str(out / "diagnosis.json")
                result.diagnosis = diagnosis_message(content, str((out / "report.html").resolve()))
                result.diagnosis.header.stamp = self._node.get_clock().now().to_msg()
                self._verdicts.publish(result.diagnosis)
        except Exception:
            self._goals.free()
            raise
        self._goals.settle(handle, bool(content))
        if content:  # rclpy knows a call by its line, and allows each one severity
            self._node.get_logger().info(result.message)
        else:
            self._node.get_logger().error(result.message)
        return result


def diagnose_task(goal: Diagnose.Goal) -> DiagnoseTask:
    """A goal as a task."""
    return DiagnoseTask(
        bags=tuple(map(typed_path, goal.bags)), model=goal.model, out=typed_path(goal.out), seed=goal.seed,
        candidates=tuple(goal.candidates),
    )  # fmt: skip
