# SPDX-License-Identifier: Apache-2.0
"""Records what is published under real/ and sim/ into one bag per side, as it comes: serialised, nothing decoded.

A topic is received with the quality of service that its publishers offer, as in rosbag2, unless a parameter sets it.
"""

import importlib
import os
import platform
import re
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, distributions, version
from pathlib import Path
from typing import Any

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import (
    DurabilityPolicy,
    QoSCompatibility,
    QoSPolicyKind,
    QoSProfile,
    ReliabilityPolicy,
    qos_check_compatible,
)
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.subscription import MessageInfo, Subscription
from rclpy.topic_endpoint_info import TopicEndpointInfo
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState

from eps_tunnel_analysis.nodes.messages import PolledGroup, nanoseconds
from eps_tunnel_analysis.recording.writer import BagWriter, RecordingError
from labyrinth_msgs.msg import BallEvent, BallState, RunningModel, Trial
from labyrinth_sim.errors import InputError, unknown_name

# Subscribed from the start; other topics under a side's namespace are found while the node runs.
TOPICS: Mapping[str, Any] = {
    "joint_commands": JointState,
    "joint_states": JointState,
    "ball": BallState,
    "ball_event": BallEvent,
    "trial": Trial,
    "model": RunningModel,
}
NOT_MEASURED = ("joint_commands", "trial")  # what the player publishes; a side measures where there is anything else
IMAGES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
TAKE_PERIOD = 0.01  # s between two looks at what has come; a wake-up per message takes several times the processor
DEPTH = 1000  # messages; enough for some seconds in which this process is not scheduled
DISCOVERY = 3.0  # s; participants announce themselves this often, so that a node of this age knows all others
QUIET = 0.5  # s without new ends of topics after which all are taken to know each other
LIBRARIES = ("eps_tunnel_analysis", "labyrinth_sim", "labyrinth_hw", "mujoco", "rosbags", "numpy")

Listener = Callable[[str, str, str, bytes, int], None]
ADAPTED = (QoSPolicyKind.RELIABILITY, QoSPolicyKind.DURABILITY)
SIZES = (QoSPolicyKind.HISTORY, QoSPolicyKind.DEPTH)
FOR_EVER = 2**63 - 1  # ns; what rosbag2 writes for "for ever"


@dataclass
class _Topic:
    """One topic of one side.

    Attributes:
        name: within the side, e.g. `joint_states`.
        full: name after remapping, as in the bag.
        kind, type: message class, and its name.
        profile: of its subscription.
        fixed: policies that parameters fix.
        latched: of each publisher, the messages that it keeps for later subscribers, with their publish times, ns.
        count: messages in the running recording.
        ends: identifiers of the publishers that match the subscription.
        reached: publishers that are matched.
        heard: whether anything arrived since the last subscription.
    """

    side: str
    name: str
    full: str
    kind: Any
    type: str
    profile: QoSProfile
    fixed: frozenset[QoSPolicyKind]
    subscription: Subscription
    order: "_Order" = field(default_factory=lambda: _Order())
    latched: dict[bytes, deque[tuple[bytes, int]]] = field(default_factory=dict)
    count: int = 0
    ends: frozenset[bytes] = frozenset()
    reached: int = 0
    heard: bool = False


class Recorder:
    """One raw subscription per topic; messages go to the side's bag and to `listen(side, name, topic, CDR, arrival)`.

    The caller must call `take` every TAKE_PERIOD, and `look` once a second; before `start`, both until nothing is
    `missing` and all is `settled`.

    Args:
        listen: `name` is the topic's within its side, `topic` its full name, `arrival` in ns.
        sim_time: log times follow /clock, as with `ros2 bag record --use-sim-time`.
    """

    def __init__(
        self, node: Node, sides: Sequence[str], listen: Listener, images: bool = False, sim_time: bool = False
    ) -> None:
        self.images = images
        self._node, self._listen = node, listen
        self._prefixes = {side: f"{node.get_namespace().rstrip('/')}/{side}/" for side in sides}
        self._writers: dict[str, BagWriter] = {}
        self._topics: dict[str, _Topic] = {}  # by the name before remapping
        self._polled = PolledGroup()
        self._unknown: set[str] = set()
        self._now = 0  # ns, of /clock
        self._clock = (
            self._subscribe(Clock, "/clock", QoSProfile(depth=100, reliability=ReliabilityPolicy.BEST_EFFORT))
            if sim_time
            else None
        )
        self._logged = 0
        self._distro = ros_distro()
        self._began = self._changed = time.monotonic()
        self.restarts: dict[str, int] = {}
        self.errors: list[str] = []
        self.model = ""
        for side, prefix in self._prefixes.items():
            for name, kind in TOPICS.items():
                self._add(side, prefix + name, kind)

    @property
    def bags(self) -> list[str]:
        """Paths of the bags being written."""
        return [str(writer.path) for writer in self._writers.values()]

    def take(self) -> None:
        """Handles every message that has come, in the order of arrival over all topics."""
        came: list[tuple[int, _Topic | None, bytes, int]] = []
        if self._clock is not None:
            with self._clock.handle:
                while (taken := self._clock.handle.take_message(Clock, False)) is not None:
                    now = nanoseconds(taken[0].clock)
                    came.append((_received(taken[1]), None, b"", now))
        for topic in self._topics.values():
            came += self._waiting(topic)
        for arrival, topic_or_clock, message, sent in sorted(came, key=lambda entry: entry[0]):
            if topic_or_clock is None:
                self._now = sent
            else:
                self._handle(topic_or_clock, arrival, message, sent)

    def look(self) -> None:
        """Subscribes to topics that are new under a side, and to known ones as their publishers now offer them."""
        for name, kinds in self._node.get_topic_names_and_types():
            side = next((side for side, prefix in self._prefixes.items() if name.startswith(prefix)), None)
            if side is None or name in self._topics or name in self._unknown or len(kinds) != 1:
                continue
            if kinds[0] in IMAGES and not self.images:
                continue
            package, _, rest = kinds[0].partition("/")
            try:
                kind = getattr(importlib.import_module(f"{package}.msg"), rest.rpartition("/")[2])
            except (ImportError, AttributeError):
                self._unknown.add(name)
                self._node.get_logger().warning(f"{name} is not recorded: its type {kinds[0]} is not installed here.")
                continue
            self._add(side, name, kind)
        for topic in self._topics.values():
            ends = self._node.get_publishers_info_by_topic(topic.full)
            self._adapt(topic, [end.qos_profile for end in ends])
            self._note(topic, ends)

    def missing(self, sides: Sequence[str]) -> list[str]:
        """What a recording that began now would not receive although it is published, or expected, in words.

        A named side is expected to publish joint states; without names any side may, while this node is too young to
        know.

        Args:
            sides: as for `start`. Call `look` before.
        """
        expected = sides or (self._prefixes if time.monotonic() < self._began + DISCOVERY else ())
        absent = [f"{prefix} (no joint states there)" for side, prefix in self._prefixes.items()
                  if side in expected and not self._measures(side)]  # fmt: skip
        deaf = [
            f"{topic.full} ({len(topic.ends) - topic.reached} of {len(topic.ends)} publishers)"
            for topic in self._topics.values()
            if topic.side in (sides or self._prefixes) and topic.reached < len(topic.ends)
        ]
        timeless = ["/clock (no publisher)"] if self._clock is not None and not self._now else []
        return absent + deaf + timeless

    @property
    def settled(self) -> bool:
        """Whether nothing new was seen for so long that the publishers also know this node's subscriptions, and the
        messages that they keep for later subscribers have arrived."""
        return time.monotonic() - self._changed > QUIET

    def check(self, sides: Sequence[str]) -> None:
        """Raises InputError where another recording runs, or a side is unknown."""
        if self._writers:
            raise InputError(f"Already recording {', '.join(self.bags)}. Stop that first.")
        if unknown := [unknown_name("side", side, self._prefixes) for side in sides if side not in self._prefixes]:
            raise InputError(unknown)

    def start(self, folder: Path, label: str, metadata: Mapping[str, str], sides: Sequence[str] = ()) -> list[str]:
        """One new bag per side, folder/LABEL_SIDE.

        Args:
            sides: those to record; if empty, those that publish joint states now.

        Raises:
            InputError: one exists, another recording runs, or there is nothing to record.
        """
        self.check(sides)
        sides = [side for side in self._prefixes if (side in sides if sides else self._measures(side))]
        if not sides:
            raise InputError(
                f"No joint states under {' or '.join(self._prefixes.values())}. Start the node of a side, or give "
                "`sides` to wait for them."
            )
        paths = {side: folder / f"{label}_{side}" for side in sides}
        taken = [str(path) for path in paths.values() if os.path.lexists(path)]
        if taken:
            raise InputError(
                f"{', '.join(taken)}: exists already and is not overwritten. Choose another folder or label."
            )
        self.take()
        self.errors.clear()
        writers: dict[str, BagWriter] = {}
        try:
            for side, path in paths.items():
                model = self.model if side == "sim" else ""
                about = {**metadata, "side": side, "model": model, **_versions(self._distro)}
                writers[side] = BagWriter(path, about, self._distro)
        except (InputError, OSError) as error:  # of a name, too, that no file system takes
            for writer in writers.values():
                writer.close()
            raise InputError(str(error)) from error
        self._writers = writers
        for topic in self._topics.values():
            topic.count = 0
            for kept in topic.latched.values():
                for message, sent in kept:
                    self._write(topic, time.time_ns(), message, sent)
        return self.bags

    def stop(self) -> list[str]:
        """Closes the bags, with all that came until now, and returns their paths; `errors` says what they lack."""
        self.take()
        bags, writers = self.bags, self._writers
        self._writers = {}
        for side, writer in writers.items():
            try:
                writer.close()
            except RecordingError as error:
                self._fail(str(error))
            states = self._topics[f"{self._prefixes[side]}joint_states"]
            if not states.count:
                self._fail(f"0 messages on {states.full}: {self._why_silent(states)} The bag is kept: {writer.path}.")
        return bags

    def _why_silent(self, topic: _Topic) -> str:
        ends = self._node.get_publishers_info_by_topic(topic.full)
        if not ends:
            return "nothing publishes there. Start its node, check namespace and ROS_DOMAIN_ID, or remap the topic."
        heard = f"{topic.profile.reliability.name}, {topic.profile.durability.name}".lower()
        names = ", ".join(f"{end.node_namespace.rstrip('/')}/{end.node_name}" for end in ends)
        return (
            f"{names} published nothing that a subscription with {heard} receives; see `ros2 topic info -v "
            f"{topic.full}`."
        )

    def _measures(self, side: str) -> bool:
        return any(
            self._node.count_publishers(topic.full)
            for topic in self._topics.values()
            if topic.side == side and topic.name not in NOT_MEASURED
        )

    def _subscribe(self, kind: Any, name: str, profile: QoSProfile, policies: Sequence[Any] = ()) -> Subscription:
        # Each event handler is one thing more that the executor waits for.
        silent = SubscriptionEventCallbacks(use_default_callbacks=False)
        return self._node.create_subscription(
            kind, name, lambda _: None, profile, raw=True, event_callbacks=silent, callback_group=self._polled,
            qos_overriding_options=QoSOverridingOptions(policies),
        )  # fmt: skip

    def _add(self, side: str, name: str, kind: Any) -> None:
        fixed = overridden(self._node, self._node.resolve_topic_name(name))
        profile = hears_all(offered(self._node, self._node.resolve_topic_name(name)), DEPTH)
        # A parameter is there where its policy is fixed; for the others no parameter would be correct.
        subscription = self._subscribe(kind, name, profile, [*SIZES, *(set(fixed) - set(SIZES))])
        type_ = f"{kind.__module__.split('.')[0]}/msg/{kind.__name__}"
        self._changed = time.monotonic()
        self._topics[name] = _Topic(
            side, name.removeprefix(self._prefixes[side]), subscription.topic_name, kind, type_, profile,
            frozenset(fixed), subscription,
        )  # fmt: skip

    def _note(self, topic: _Topic, ends: Sequence[TopicEndpointInfo]) -> None:
        """Notes who publishes a topic, who of them is matched, and whether anything of that changed."""
        known = frozenset(
            bytes(end.endpoint_gid)
            for end in ends
            if end.topic_type == topic.type and hears(topic.profile, end.qos_profile)
        )
        reached = topic.subscription.get_publisher_count()
        if (known, reached) != (topic.ends, topic.reached):
            topic.ends, topic.reached, self._changed = known, reached, time.monotonic()

    def _adapt(self, topic: _Topic, profiles: Sequence[QoSProfile]) -> None:
        """Hears a topic as its publishers offer it; while recording only where it is deaf to one of them."""
        if not profiles:
            topic.latched.clear()
            return
        wanted, old = hears_all(profiles, topic.profile.depth), topic.profile
        wanted.history = old.history
        if QoSPolicyKind.RELIABILITY in topic.fixed:
            wanted.reliability = old.reliability
        if QoSPolicyKind.DURABILITY in topic.fixed:
            wanted.durability = old.durability
        deaf = (
            (old.reliability, wanted.reliability) == (ReliabilityPolicy.RELIABLE, ReliabilityPolicy.BEST_EFFORT)
        ) or (old.durability, wanted.durability) == (DurabilityPolicy.TRANSIENT_LOCAL, DurabilityPolicy.VOLATILE)
        same = (old.reliability, old.durability) == (wanted.reliability, wanted.durability)
        if same or (topic.side in self._writers and not deaf):
            return
        for arrival, _, message, sent in self._waiting(topic):
            self._handle(topic, arrival, message, sent)
        self._node.destroy_subscription(topic.subscription)
        topic.latched.clear()
        topic.profile, topic.subscription = wanted, self._subscribe(topic.kind, topic.full, wanted)
        topic.heard, self._changed = False, time.monotonic()

    def _waiting(self, topic: _Topic) -> list[tuple[int, _Topic | None, bytes, int]]:
        came: list[tuple[int, _Topic | None, bytes, int]] = []
        with topic.subscription.handle:
            while (taken := topic.subscription.handle.take_message(topic.subscription.msg_type, True)) is not None:
                message, info = taken
                arrival = topic.order.arrival(info)
                sent = int(info["source_timestamp"] or arrival)
                came.append((arrival, topic, message, sent))
                if not topic.heard:
                    topic.heard, self._changed = True, time.monotonic()
                if topic.profile.durability == DurabilityPolicy.TRANSIENT_LOCAL:
                    self._keep(topic, message, sent)
        return came

    def _keep(self, topic: _Topic, message: bytes, sent: int) -> None:
        """Keeps what a publisher would give to those who subscribe when the next recording starts."""
        depth = max((p.depth for p in offered(self._node, topic.full)), default=1)
        topic.latched.setdefault(topic.order.publisher, deque(maxlen=max(1, depth))).append((message, sent))

    def _handle(self, topic: _Topic, arrival: int, message: bytes, sent: int) -> None:
        self.restarts[topic.full] = topic.order.restarts
        self._write(topic, arrival, message, sent)
        self._listen(topic.side, topic.name, topic.full, message, arrival)

    def _write(self, topic: _Topic, arrival: int, message: bytes, sent: int) -> None:
        writer = self._writers.get(topic.side)
        if writer is None:
            return
        if self._clock is not None:  # as rosbag2 does it, both times are those of /clock
            self._logged = arrival = sent = max(self._logged + 1, self._now)
        try:
            if not topic.count:
                profiles = [as_in_bags(profile) for profile in offered(self._node, topic.full)]
                writer.add_topic(topic.full, topic.type, offered=profiles)
            topic.count += 1
            writer.write(topic.full, arrival, message, sent)
        except (InputError, RecordingError) as error:
            self._fail(str(error))

    def _fail(self, message: str) -> None:
        if message not in self.errors:
            self.errors.append(message)
            self._node.get_logger().error(message)


class _Order:
    """Arrival times in the order of delivery, who published last, and how often the publisher was replaced.

    What DDS sends again, when publisher and reader have just found each other say, arrives after its successors, yet is
    delivered before them. A bag is read by log time, which must not undo that order.
    """

    def __init__(self) -> None:
        self._last, self.publisher, self.restarts = 0, b"", 0

    def arrival(self, info: MessageInfo) -> int:
        """ns by this machine's clock, later than that of the message before."""
        publisher = info.get("publisher_gid", {}).get("data", b"")  # newer than Jazzy
        if publisher != self.publisher:
            self.restarts += bool(self.publisher)
            self.publisher = publisher
        self._last = max(self._last + 1, _received(info))
        return self._last


def _received(info: MessageInfo) -> int:
    """ns, when a message came, by this machine's clock."""
    return int(info["received_timestamp"] or time.time_ns())


def ros_distro() -> str:
    """The ROS release that runs, e.g. `kilted`; empty if it is not known."""
    if distro := os.environ.get("ROS_DISTRO"):
        return distro
    names = (re.fullmatch(r"ros-([a-z]+)-rclpy", d.metadata["Name"] or "") for d in distributions())
    return next((match[1] for match in names if match), "")


def _versions(distro: str) -> dict[str, str]:
    versions = {"python": platform.python_version(), "ros": distro}
    for library in LIBRARIES:
        try:
            versions[library] = version(library)
        except PackageNotFoundError:
            continue
    return {f"version.{key}": value for key, value in versions.items() if value}


def offered(node: Node, topic: str) -> list[QoSProfile]:
    """The profile of each publisher of a topic, by its full name."""
    return [end.qos_profile for end in node.get_publishers_info_by_topic(topic)]


def hears_all(profiles: Sequence[QoSProfile], depth: int) -> QoSProfile:
    """A subscription's profile that every one of some publishers matches: as strict as the least strict of them."""
    reliable = all(p.reliability != ReliabilityPolicy.BEST_EFFORT for p in profiles)
    latched = bool(profiles) and all(p.durability == DurabilityPolicy.TRANSIENT_LOCAL for p in profiles)
    return QoSProfile(
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


def hears(subscription: QoSProfile, publisher: QoSProfile) -> bool:
    """Whether a subscription with one profile hears a publisher with another."""
    return qos_check_compatible(publisher, subscription)[0] != QoSCompatibility.ERROR


def overridden(node: Node, topic: str) -> dict[QoSPolicyKind, Any]:
    """Policies that parameters `qos_overrides.TOPIC.subscription.POLICY` fix, with their values as given."""
    given = node._parameter_overrides
    names = {policy: f"qos_overrides.{topic}.subscription.{policy.name.lower()}" for policy in (*SIZES, *ADAPTED)}
    return {policy: given[name].value for policy, name in names.items() if name in given}


def as_in_bags(profile: QoSProfile) -> Qos:
    """A publisher's profile in the format of metadata.yaml."""

    def time(nanoseconds: int) -> QosTime:
        return QosTime(*divmod(min(nanoseconds, FOR_EVER), 10**9))

    return Qos(
        QosHistory[profile.history.name],
        profile.depth,
        QosReliability[profile.reliability.name],
        QosDurability[profile.durability.name],
        time(profile.deadline.nanoseconds),
        time(profile.lifespan.nanoseconds),
        QosLiveliness[profile.liveliness.name],
        time(profile.liveliness_lease_duration.nanoseconds),
        bool(profile.avoid_ros_namespace_conventions),
    )
