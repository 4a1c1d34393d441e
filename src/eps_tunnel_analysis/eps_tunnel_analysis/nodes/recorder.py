# SPDX-License-Identifier: Apache-2.0
"""Records what is published under /real and /sim into one bag per side, as it comes: serialised, nothing decoded."""

import importlib
import os
import platform
import time
from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.subscription import MessageInfo, Subscription
from sensor_msgs.msg import JointState

from eps_tunnel_analysis.nodes.polled import PolledGroup
from eps_tunnel_analysis.recording.writer import BagWriter, RecordingError
from labyrinth_msgs.msg import BallEvent, BallState, Trial
from labyrinth_sim.errors import InputError

# Subscribed from the start; whatever else appears under a side's namespace is found while the node runs.
TOPICS: Mapping[str, Any] = {
    "joint_commands": JointState,
    "joint_states": JointState,
    "ball": BallState,
    "ball_event": BallEvent,
    "trial": Trial,
}
IMAGES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
# Deep enough for some seconds in which this process is not scheduled.
DEEP = QoSProfile(depth=1000, reliability=ReliabilityPolicy.RELIABLE)
PERIOD = 0.01  # s between two looks at what has come; a wake-up per message takes several times the processor
LIBRARIES = ("eps_tunnel_analysis", "labyrinth_sim", "labyrinth_hw", "mujoco", "rosbags", "numpy")

Listener = Callable[[str, str, bytes, int], None]


class Recorder:
    """One raw subscription per topic; messages go to the side's bag and to `listen(side, topic, CDR, arrival ns)`.

    Somebody has to call `take` every PERIOD.
    """

    def __init__(self, node: Node, sides: Sequence[str], listen: Listener, images: bool = False) -> None:
        self._node, self._listen, self._images = node, listen, images
        self._writers: dict[str, BagWriter] = {}
        self._topics: dict[str, dict[str, str]] = {side: {} for side in sides}
        self._subscriptions: list[tuple[Subscription, _Order, Callable[[int, bytes], None]]] = []
        self._polled = PolledGroup()
        self._unknown: set[str] = set()
        self.restarts: dict[str, int] = {}
        self.errors: list[str] = []
        self.models: dict[str, str] = {}
        for side in sides:
            for name, kind in TOPICS.items():
                self._subscribe(side, f"/{side}/{name}", kind)

    @property
    def bags(self) -> list[str]:
        """Paths of the bags being written."""
        return [str(writer.path) for writer in self._writers.values()]

    def take(self) -> None:
        """Handles every message that has come, in the order of arrival over all topics."""
        came: list[tuple[int, Callable[[int, bytes], None], bytes]] = []
        for subscription, order, handle in self._subscriptions:
            with subscription.handle:
                while (taken := subscription.handle.take_message(subscription.msg_type, True)) is not None:
                    came.append((order.arrival(taken[1]), handle, taken[0]))
        for arrival, handle, message in sorted(came, key=lambda entry: entry[0]):
            handle(arrival, message)

    def look(self) -> None:
        """Subscribes to topics that are new under a side's namespace."""
        for name, kinds in self._node.get_topic_names_and_types():
            side = name.split("/")[1] if name.count("/") > 1 else ""
            if side not in self._topics or name in self._topics[side] or name in self._unknown or len(kinds) != 1:
                continue
            if kinds[0] in IMAGES and not self._images:
                self._unknown.add(name)
                continue
            package, _, rest = kinds[0].partition("/")
            try:
                kind = getattr(importlib.import_module(f"{package}.msg"), rest.rpartition("/")[2])
            except (ImportError, AttributeError):
                self._unknown.add(name)
                self._node.get_logger().warning(f"{name} is not recorded: its type {kinds[0]} is not installed here.")
                continue
            self._subscribe(side, name, kind)

    def start(self, folder: Path, label: str, metadata: Mapping[str, str]) -> list[str]:
        """One new bag per side, folder/LABEL_SIDE. Raises InputError when one exists or another recording runs."""
        if self._writers:
            raise InputError(f"Already recording {', '.join(self.bags)}. Stop that first.")
        paths = {side: folder / f"{label}_{side}" for side in self._topics}
        taken = [str(path) for path in paths.values() if path.exists()]
        if taken:
            raise InputError(
                f"{', '.join(taken)}: exists already and is not overwritten. Choose another folder or label."
            )
        self.errors.clear()
        writers: dict[str, BagWriter] = {}
        try:
            for side, path in paths.items():
                writers[side] = BagWriter(
                    path, {**metadata, "side": side, "model": self.models.get(side, ""), **_versions()}
                )
                for topic, kind in self._topics[side].items():
                    self._announce(writers[side], side, topic, kind)
        except (InputError, RecordingError) as error:
            for writer in writers.values():
                writer.close()
            raise InputError(str(error)) from error
        self._writers = writers
        return self.bags

    def stop(self) -> list[str]:
        """Closes the bags, with all that came until now, and returns their paths.

        Raises InputError when one cannot be finished.
        """
        self.take()
        bags, writers = self.bags, list(self._writers.values())
        self._writers = {}
        for writer in writers:
            try:
                writer.close()
            except RecordingError as error:
                self._fail(str(error))
        if self.errors:
            raise InputError(self.errors)
        return bags

    def _subscribe(self, side: str, name: str, kind: Any) -> None:
        order = _Order()

        def received(arrival: int, message: bytes) -> None:
            self.restarts[name] = order.restarts
            writer = self._writers.get(side)
            if writer is not None:
                try:
                    writer.write(topic, arrival, message)
                except (InputError, RecordingError) as error:
                    self._fail(str(error))
            self._listen(side, name, message, arrival)

        # Each event handler is one thing more that the executor waits for.
        silent = SubscriptionEventCallbacks(use_default_callbacks=False)
        subscription = self._node.create_subscription(
            kind, name, lambda _: None, DEEP, raw=True, event_callbacks=silent, callback_group=self._polled
        )
        topic = subscription.topic_name
        self._subscriptions.append((subscription, order, received))
        self._topics[side][topic] = f"{kind.__module__.split('.')[0]}/msg/{kind.__name__}"
        if side in self._writers:
            self._announce(self._writers[side], side, topic, self._topics[side][topic])

    def _announce(self, writer: BagWriter, side: str, topic: str, kind: str) -> None:
        try:
            writer.add_topic(topic, kind)
        except InputError as error:
            self._node.get_logger().warning(str(error))

    def _fail(self, message: str) -> None:
        if message not in self.errors:
            self.errors.append(message)
            self._node.get_logger().error(message)


class _Order:
    """Arrival times in the order of delivery, and how often the publisher was replaced.

    What DDS sends again, when publisher and reader have just found each other say, arrives after its successors, yet is
    delivered before them. A bag is read by log time, which must not undo that order.
    """

    def __init__(self) -> None:
        self._last, self._publisher, self.restarts = 0, b"", 0

    def arrival(self, info: MessageInfo) -> int:
        """ns by this machine's clock, later than that of the message before."""
        publisher = info.get("publisher_gid", {}).get("data", b"")  # newer than Jazzy
        if publisher != self._publisher:
            self.restarts += bool(self._publisher)
            self._publisher = publisher
        self._last = max(self._last + 1, info["received_timestamp"] or time.time_ns())
        return self._last


def _versions() -> dict[str, str]:
    found = {"python": platform.python_version(), "ros": os.environ.get("ROS_DISTRO", "")}
    for library in LIBRARIES:
        try:
            found[library] = version(library)
        except PackageNotFoundError:
            continue
    return {f"version.{key}": value for key, value in found.items() if value}
