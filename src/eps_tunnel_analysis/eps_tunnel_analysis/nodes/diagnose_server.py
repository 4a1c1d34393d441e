# SPDX-License-Identifier: Apache-2.0
"""Diagnoses on request, in a process of its own, so that the live figures go on."""

import json
import math
import threading
from pathlib import Path
from typing import Any

from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle

from eps_tunnel_analysis.command_process import run_command
from eps_tunnel_analysis.nodes.common import TunnelNode
from eps_tunnel_analysis.nodes.diagnosis_message import LATCHED, diagnosis_message
from labyrinth_msgs.action import Diagnose
from labyrinth_msgs.msg import Diagnosis

MANY = 1500  # roll-outs; the scale of the progress, for how many there will be is not known before


class DiagnoseServer:
    """Action server /diagnose of a node, and its latched topic /srg/diagnosis."""

    def __init__(self, node: TunnelNode) -> None:
        self._node = node
        self._working = threading.Lock()
        self._thread: threading.Thread | None = None
        self._verdicts = node.create_publisher(Diagnosis, "/srg/diagnosis", LATCHED)
        self._server = ActionServer(
            node, Diagnose, "/diagnose", lambda _: Diagnose.Result(), goal_callback=self._goal,
            handle_accepted_callback=self._accepted, cancel_callback=lambda _: CancelResponse.ACCEPT,
        )  # fmt: skip

    @property
    def busy(self) -> bool:
        """While a diagnosis runs."""
        return self._working.locked()

    def close(self) -> None:
        """Waits for the end of what runs; `node.stopping` calls it off."""
        self._server.destroy()
        if self._thread is not None:
            self._thread.join()

    def _goal(self, goal: Diagnose.Goal) -> GoalResponse:
        if self._node.stopping.is_set() or not self._working.acquire(blocking=False):
            self._node.get_logger().warning(f"Refused to diagnose '{goal.model}': another diagnosis is under way.")
            return GoalResponse.REJECT
        return GoalResponse.ACCEPT

    def _accepted(self, handle: ServerGoalHandle[Any, Any, Any]) -> None:
        self._thread = threading.Thread(target=self._work, args=(handle,), name="diagnose")
        self._thread.start()

    def _work(self, handle: ServerGoalHandle[Any, Any, Any]) -> None:
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
            output = run_command(
                arguments(goal), tell, lambda: handle.is_cancel_requested or self._node.stopping.is_set()
            )
            if output.code == 0:
                content = json.loads(output.text)
            else:
                message = "\n".join(output.complaints) or f"It ended with exit code {output.code}."
        except Exception as error:  # a thread that died silently would leave the node busy for ever
            message = f"The diagnosis failed: {error!r}."
        handle.execute(lambda h: self._finish(h, content, message))

    def _finish(
        self, handle: ServerGoalHandle[Any, Any, Any], content: dict[str, Any], message: str
    ) -> Diagnose.Result:
        result = Diagnose.Result(success=bool(content), message=message)
        try:
            if content:
                out = Path(handle.request.out).expanduser()
                result.message, result.file = content["sentence"], str(out / "diagnosis.json")
                result.diagnosis = diagnosis_message(content, str((out / "report.html").resolve()))
                result.diagnosis.header.stamp = self._node.get_clock().now().to_msg()
                self._verdicts.publish(result.diagnosis)
                handle.succeed()
            elif handle.is_cancel_requested:
                handle.canceled()
            else:
                handle.abort()
        finally:
            self._working.release()
        if content:  # rclpy knows a call by its line, and allows each one severity
            self._node.get_logger().info(result.message)
        else:
            self._node.get_logger().error(result.message)
        return result


def arguments(goal: Diagnose.Goal) -> list[str]:
    """A goal as the command line takes it."""
    given = ["diagnose", "--real", *goal.bags, "--model", goal.model, "--out", goal.out, "--seed", str(goal.seed)]
    given += ["--candidates", *goal.candidates] if goal.candidates else []
    return [*given, "--json", "--progress", "lines"]
