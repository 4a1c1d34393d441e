# SPDX-License-Identifier: Apache-2.0
"""Overriding the quality of service of one topic changes that one and no other."""

import os

import pytest

pytest.importorskip("rclpy", reason="needs ROS 2 and the built workspace: make setup")
pytest.importorskip("labyrinth_msgs", reason="needs ROS 2 and the built workspace: make setup")

import rclpy
from rclpy.qos import ReliabilityPolicy

from eps_tunnel_analysis.motion import RestWatch
from eps_tunnel_analysis.nodes.pace import Pace
from eps_tunnel_analysis.nodes.rig_side import RigSide


def test_an_override_of_one_publisher_changes_no_other(domain: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(os.environ, "ROS_DOMAIN_ID", str(domain))
    override = "qos_overrides./real/joint_commands.publisher.reliability:=best_effort"
    rclpy.init(args=["--ros-args", "-p", override])
    node = rclpy.create_node("overridden")
    try:
        pace = Pace(node.get_clock(), simulated=False)
        sides = [RigSide(node, side, RestWatch(0.5, 0.01), pace) for side in ("real", "sim")]
        found = {p.topic_name: p.qos_profile.reliability for p in node.publishers if "joint" in p.topic_name}
        heard = {s.topic_name: s.qos_profile.reliability for s in node.subscriptions if "joint" in s.topic_name}
        assert len(sides) == len(found) == len(heard) == 2
        assert found["/real/joint_commands"] == ReliabilityPolicy.BEST_EFFORT
        assert found["/sim/joint_commands"] == ReliabilityPolicy.RELIABLE
        assert set(heard.values()) == {ReliabilityPolicy.BEST_EFFORT}, "measurements are heard from any publisher"
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
