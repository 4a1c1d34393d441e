# SPDX-License-Identifier: Apache-2.0
"""Nodes as real processes on a domain of their own, and a client that talks to them."""

import os
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import rclpy
from rclpy.action import ActionClient
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

from eps_tunnel_analysis.nodes.answers import Meeting
from eps_tunnel_analysis.nodes.rig_processes import executable
from eps_tunnel_analysis.processes import Processes

PATIENCE = 60.0  # s; only what hangs takes so long


def free_port() -> int:
    """A port of this machine on which nothing listens."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def from_home(path: Path) -> str:
    """A path as a person types it, beginning with `~`."""
    return os.path.join("~", os.path.relpath(path, Path.home()))


class Workplace:
    """Processes, and a node in this process on the same domain."""

    def __init__(self, folder: Path, domain: int) -> None:
        os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
        self.folder = folder
        logs = folder / "logs"
        logs.mkdir(parents=True)
        self.environment = {**os.environ, "ROS_DOMAIN_ID": str(domain), "PYTHONUNBUFFERED": "1"}
        self.processes = Processes(logs, self.environment)
        self.context = Context()
        rclpy.init(args=[], context=self.context, domain_id=domain)
        self.node = Node("test_client", context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)

    def start(self, package: str, name: str, called: str = "", **parameters: object) -> None:
        """Starts PACKAGE's NAME with parameters."""
        given = [part for key, value in parameters.items() for part in ("-p", f"{key}:={value}")]
        node_name = ["-r", f"__node:={called}"] if called else []
        self.processes.start(called or name, [executable(package, name), "--ros-args", *node_name, *given])

    def until(self, done: Callable[[], Any]) -> Any:
        """Spins until `done()` is true, and returns that; fails when a process dies."""
        deadline = time.monotonic() + PATIENCE
        while not (result := done()):
            self.executor.spin_once(timeout_sec=0.05)
            self.processes.check()
            assert time.monotonic() < deadline, "waited too long"
        return result

    def result(self, future: Any) -> Any:
        """What a future ends with."""
        self.until(future.done)
        return future.result()

    def action(self, kind: Any, name: str) -> Any:
        """A client of an action, once its server and it have found each other."""
        client: Any = ActionClient(self.node, kind, name)
        self.until(Meeting(self.node, client, name).done)
        return client

    def call(self, client: Any, request: Any) -> Any:
        """A service's answer."""
        self.until(client.service_is_ready)
        return self.result(client.call_async(request))

    def close(self) -> None:
        self.processes.stop()
        self.executor.shutdown()
        self.node.destroy_node()
        self.context.try_shutdown()


@contextmanager
def workplace(folder: Path, domain: int) -> Iterator[Workplace]:
    place = Workplace(folder, domain)
    try:
        yield place
    finally:
        place.close()
