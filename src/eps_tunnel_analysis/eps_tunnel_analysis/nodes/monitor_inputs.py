# SPDX-License-Identifier: Apache-2.0
"""What the monitor hears on the topics, written into its state."""

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from rclpy.node import Node
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState

from eps_tunnel_analysis.monitor.parts import Health, Pose, Scene, VerdictPart
from eps_tunnel_analysis.monitor.state import RecentHealth, State, Steps
from eps_tunnel_analysis.nodes.common import SIDES
from eps_tunnel_analysis.nodes.messages import (
    PolledGroup,
    PolledTopic,
    deep,
    latched,
    nanoseconds,
    newest,
    reliable,
)
from labyrinth_msgs.msg import BallState, Diagnosis, LiveCounters, RunningModel, Srg, Trial, TunnelSample

SILENT = 1.0  # s without joint states after which a side is gone
BALL_GONE = 0.5  # s without a sight of the ball after which it is not drawn
ANALYSIS_SILENT = 4.0  # s


class Inputs:
    """Takes what came since the last look and shows it.

    Attributes:
        duration: s, of the command whose trial began last.
    """

    def __init__(self, node: Node, state: State, steps: Steps) -> None:
        group = PolledGroup()

        def topic(kind: Any, name: str, qos: QoSProfile) -> PolledTopic:
            return PolledTopic(node, kind, name, qos, group)

        self._state, self._steps, self._logger = state, steps, node.get_logger()
        self._joints = {side: topic(JointState, f"{side}/joint_states", newest()) for side in SIDES}
        self._balls = {side: topic(BallState, f"{side}/ball", newest()) for side in SIDES}
        self._trials = {side: topic(Trial, f"{side}/trial", reliable(20)) for side in SIDES}
        self._tunnel = topic(TunnelSample, "srg/tunnel", deep())
        self._srg = topic(Srg, "srg", reliable(20))
        self._counters = topic(LiveCounters, "srg/counters", reliable(20))
        self._diagnosis = topic(Diagnosis, "srg/diagnosis", latched())
        self._models = topic(RunningModel, "sim/model", latched())
        self._poses: dict[str, tuple[float, dict[str, float]]] = {}
        self._seen: dict[str, tuple[float, tuple[float, float]]] = {}
        self._heard = -1e9
        self._health = RecentHealth()
        self.duration = 0.0
        self.own_verdict = -1  # ns, stamp of the verdict that this node published

    def alive(self, side: str) -> bool:
        """Whether a side measures."""
        return side in self._poses and time.monotonic() - self._poses[side][0] < SILENT

    @property
    def analysed(self) -> bool:
        """Whether the analysis node is there."""
        return time.monotonic() - self._heard < ANALYSIS_SILENT

    def take(self) -> bool:
        """Returns whether the simulation runs another model than before."""
        changed = False
        for model in self._models.take():
            changed |= self._steps.runs(model.name, model.file, str(model.loaded))
        for side in SIDES:
            for mark in self._trials[side].take():
                self._marked(side, mark)
        self._take_tunnel()
        for figures in self._srg.take():
            if not self._fits(figures, _fits_srg):
                continue
            self._steps.gap(
                figures.signals,
                figures.k,
                figures.alikeness,
                figures.joint,
                figures.samples,
                figures.trials,
                figures.rig_joint,
            )
            with self._state.tunnel() as table:
                table.trials = figures.trials
        for counters in self._counters.take():
            self._heard = time.monotonic()
            self._state.put(self._health.at(self._heard, _health(counters)))
        for verdict in self._diagnosis.take():
            if nanoseconds(verdict.header.stamp) != self.own_verdict:
                self._state.put(_verdict(verdict, self._steps.model))
        self._take_scene()
        return changed

    def _marked(self, side: str, mark: Trial) -> None:
        if mark.phase == Trial.START:
            self.duration = mark.duration
            if side == "sim":
                self._steps.trial_started()
            self._state.trial(mark.sequence_hash, mark.duration)

    def _take_tunnel(self) -> None:
        samples = list(self._tunnel.take())
        if not samples:
            return
        with self._state.tunnel() as table:
            for s in samples:
                if not self._fits(s, _fits_tunnel):
                    continue
                table.add(
                    s.time, s.signals, np.array(s.mean), np.array(s.lower), np.array(s.upper), np.array(s.simulated),
                    s.alike,
                )  # fmt: skip

    def _fits(self, message: Any, whether: Callable[[Any], bool]) -> bool:
        """Whether the parts of a message belong together; another than ours may have sent it."""
        fits = whether(message)
        if not fits:
            text = f"Left out a {type(message).__name__} whose numbers are not as many as its signals ask for."
            self._logger.warning(text, throttle_duration_sec=1.0)
        return fits

    def _take_scene(self) -> None:
        now = time.monotonic()
        for side in SIDES:
            for joints in self._joints[side].take():
                angles = zip(joints.name, joints.position, strict=False)
                self._poses[side] = (now, {name: round(angle, 5) for name, angle in angles})
            for ball in self._balls[side].take():
                if ball.visible:
                    self._seen[side] = (now, (round(ball.x, 5), round(ball.y, 5)))
        self._state.put(Scene(*(self._pose(side, now) for side in SIDES)))

    def _pose(self, side: str, now: float) -> Pose | None:
        if not self.alive(side):
            return None
        seen, place = self._seen.get(side, (-1e9, None))
        return Pose(self._poses[side][1], place if now - seen < BALL_GONE else None)


def _fits_srg(figures: Srg) -> bool:
    n = len(figures.k)
    wanted = len(figures.signals) * n
    return (len(figures.alikeness), len(figures.joint)) == (wanted, n) and len(figures.rig_joint) in (0, n)


def _fits_tunnel(sample: TunnelSample) -> bool:
    parts = (sample.mean, sample.lower, sample.upper, sample.simulated, sample.alike)
    return all(len(part) == len(sample.signals) for part in parts)


def _health(counters: LiveCounters) -> Health:
    return Health(
        received=sum(counters.received), late=sum(counters.late), lost=sum(counters.lost),
        reordered=sum(counters.reordered), duplicated=sum(counters.duplicated), restarts=counters.restarts,
        clock_jumps=counters.clock_jumps,
    )  # fmt: skip


def _verdict(told: Diagnosis, model: str) -> VerdictPart:
    """The verdict of somebody else."""
    pairs = zip(told.candidates, told.probabilities, strict=False)
    return VerdictPart(
        verdict=told.verdict, sentence=told.sentence, effects=tuple(told.effects),
        hypotheses=tuple((name, p, False) for name, p in pairs), where=(), coverage=told.coverage,
        held_out=(told.held_out_before, None, told.held_out_after), model=model, next_experiment=told.next_experiment,
        report="", notes=(),
    )  # fmt: skip
