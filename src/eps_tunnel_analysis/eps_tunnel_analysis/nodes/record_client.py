# SPDX-License-Identifier: Apache-2.0
"""Asks the analysis node to record."""

import threading
from pathlib import Path
from typing import Any

from rclpy.node import Node

from eps_tunnel_analysis.sequence import Command
from labyrinth_msgs.srv import Record
from labyrinth_sim.errors import InputError

APPEARS = 10.0  # s


class RecordClient:
    """Calls /record from a thread that may wait, while the node is spun by others."""

    def __init__(self, node: Node) -> None:
        self._client = node.create_client(Record, "/record")

    def start(self, folder: Path, command: Command, timeout: float) -> tuple[str, ...]:
        """Paths of the bags that are now recorded, one per side. Raises InputError when nobody records."""
        label = command.name.replace("/", "_")
        return self._call(
            Record.Request(
                start=True, folder=str(folder.resolve()), label=label, sequence=command.name, sequence_hash=command.hash
            ),
            timeout,
        )

    def stop(self, timeout: float) -> tuple[str, ...]:
        """Paths of the bags, now closed. Raises InputError when it failed."""
        return self._call(Record.Request(start=False), timeout)

    def _call(self, request: Record.Request, timeout: float) -> tuple[str, ...]:
        if not self._client.wait_for_service(APPEARS):
            raise InputError(
                f"Nobody records: the service {self._client.service_name} did not appear within {APPEARS:g} s. "
                "Start `ros2 run eps_tunnel_analysis analysis_node`, or play without recording."
            )
        answered = threading.Event()
        future: Any = self._client.call_async(request)
        future.add_done_callback(lambda _: answered.set())
        if not answered.wait(timeout):
            raise InputError(f"The analysis node did not answer {self._client.service_name} within {timeout:g} s.")
        response: Record.Response = future.result()
        if not response.success:
            raise InputError(f"Recording failed: {response.message}")
        return tuple(response.bags)
