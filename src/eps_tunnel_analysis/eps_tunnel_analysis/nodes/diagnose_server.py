# SPDX-License-Identifier: Apache-2.0
"""Diagnoses on request, in a process of its own, so that the live figures go on."""

import json
import math
from pathlib import Path
from typing import Any

from eps_tunnel_analysis.command_process import run_command, timing_options
from eps_tunnel_analysis.nodes.common import TunnelNode
from eps_tunnel_analysis.nodes.diagnosis_message import LATCHED, diagnosis_message
from eps_tunnel_analysis.nodes.one_goal import Handle, OneGoal
from labyrinth_msgs.action import Diagnose
from labyrinth_msgs.msg import Diagnosis

MANY = 1500  # roll-outs; the scale of the progress, for how many there will be is not known before


class DiagnoseServer:
    """Action server /diagnose of a node, and its latched topic /srg/diagnosis."""

    def __init__(self, node: TunnelNode) -> None:
        self._node = node
        self._verdicts = node.create_publisher(Diagnosis, "/srg/diagnosis", LATCHED)
        self._goals = OneGoal(
            node, Diagnose, "/diagnose",
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
        counts: dict[str, int] = {}

        def tell(told: dict[str, Any]) -> None:
            counts[str(told["doing"])] = int(told["rollouts"])
            done = sum(counts.values())
            stage = f"{told['doing']}, {done:,} roll-outs"
            share = 1.0 - math.exp(-done / MANY)
            handle.publish_feedback(Diagnose.Feedback(progress=share, best=math.nan, stage=stage))

        goal: Diagnose.Goal = handle.request
        content: dict[str, Any] = {}
        message = ""
        try:
            output = run_command(arguments(goal), tell, lambda: self._goals.stopped(handle))
            if output.code == 0:
                content = json.loads(output.text)
            else:
                message = "\n".join(output.complaints) or f"It ended with exit code {output.code}."
        except Exception as error:  # a thread that died silently would leave the node busy for ever
            message = f"The diagnosis failed: {error!r}."
        handle.execute(lambda h: self._finish(h, content, message))

    def _finish(self, handle: Handle, content: dict[str, Any], message: str) -> Diagnose.Result:
        result = Diagnose.Result(success=bool(content), message=message)
        try:
            if content:
                out = Path(handle.request.out).expanduser()
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


def arguments(goal: Diagnose.Goal) -> list[str]:
    """A goal as the command line takes it."""
    given = ["diagnose", "--real", *goal.bags, "--model", goal.model, "--out", goal.out, "--seed", str(goal.seed)]
    given += timing_options()
    return [*given, "--candidates", *goal.candidates] if goal.candidates else given
