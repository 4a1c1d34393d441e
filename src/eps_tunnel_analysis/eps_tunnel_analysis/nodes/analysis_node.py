# SPDX-License-Identifier: Apache-2.0
"""Records both sides, and follows the gap between them while they run."""

import math
import sys
import time
from array import array
from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.serialization import deserialize_message
from rclpy.task import Future
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64

from eps_tunnel_analysis.alikeness import KS
from eps_tunnel_analysis.live import Figures, Judged, LiveGap, StampCounts
from eps_tunnel_analysis.nodes.common import SIDES, Handle, OneGoal, TunnelNode, attempted, run_node
from eps_tunnel_analysis.nodes.messages import diagnosis_message, latched, nanoseconds, to_time
from eps_tunnel_analysis.nodes.recorder import TAKE_PERIOD, Recorder
from eps_tunnel_analysis.recording import read, to_plays
from eps_tunnel_analysis.recording.recording import Phase, TrialMark
from eps_tunnel_analysis.recording.trials import RATE
from eps_tunnel_analysis.tasks import DiagnoseTask, run_task
from labyrinth_msgs.action import Diagnose
from labyrinth_msgs.msg import BallState, Diagnosis, LiveCounters, RunningModel, Srg, Trial, TunnelSample
from labyrinth_msgs.srv import Record
from labyrinth_sim.config import typed_path
from labyrinth_sim.errors import InputError
from labyrinth_sim.model import load_model
from labyrinth_sim.rig import BALL_SIGNALS, WORD

PHASES: dict[int, Phase] = {Trial.START: "start", Trial.END: "end", Trial.ABORTED: "aborted"}
SUFFIX_FIELDS = {"": "position", "_velocity": "velocity", "_effort": "effort"}
SUFFIX_UNITS = {"": "rad", "_velocity": "rad/s", "_effort": "N m"}
LOWEST_RATE = 1.0  # Hz
FAREWELL = 0.5  # s to stay after a last answer: DDS drops what its reader has not taken when the sender leaves


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
        """Waits for the end of the current job; `node.stopping` cancels it."""
        self._goals.close()

    def _work(self, handle: Handle) -> None:
        def publish(progress: dict[str, Any]) -> None:
            done, of = int(progress["rollouts"]), int(progress["of"])
            stage = f"{progress['doing']}, {done:,} roll-outs"
            share = done / of if of else 0.0
            handle.publish_feedback(Diagnose.Feedback(progress=share, best=math.nan, stage=stage))

        def diagnose() -> tuple[dict[str, Any], str]:
            result = run_task(diagnose_task(handle.request), publish, lambda: self._goals.stopped(handle))
            return result.content or {}, result.complaint

        content, message = attempted("diagnosis", diagnose, lambda message: ({}, message))
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
        self._node.say(bool(content), result.message)
        return result


def diagnose_task(goal: Diagnose.Goal) -> DiagnoseTask:
    """A goal as a task. Raises pydantic's ValidationError."""
    return DiagnoseTask(
        bags=tuple(map(typed_path, goal.bags)), model=goal.model, out=typed_path(goal.out), seed=goal.seed,
        candidates=tuple(goal.candidates),
    )  # fmt: skip


class AnalysisNode(TunnelNode):
    """Service record, action diagnose; topics srg, srg/tunnel, srg/SIGNAL/alikeness, srg/diagnosis, srg/counters and
    /diagnostics."""

    def __init__(self) -> None:
        super().__init__("analysis_node")
        signals = self.parameter("signals", [""], "Signals to compare; empty: the positions that both sides measure")
        ks = self.parameter("ks", list(KS), "Factors by which the real tunnel is widened", "1")
        k_sim = self.parameter("k_sim", 1.0, "Factor by which the simulated tunnel is widened", "1", 0, 1000)
        smoothed = self.parameter("smoothed", True, "Smooth the tunnel over 11 samples, equation 12")
        rate = self.parameter("rate", 0.0, "Samples per second of the grid on which both sides are compared; 0: the "
                              "rate of the simulation's rig, or 100 without one", "Hz", 0, 1000)  # fmt: skip
        max_gap = self.parameter("max_gap", 0.1, "Longest span between measurements that is bridged", "s", 0.001, 10)
        late = self.parameter("late_after", 0.1, "Age at arrival from which a message counts as late", "s", 0.001, 60,
                              changes=True)  # fmt: skip
        srg_rate = self.parameter("srg_rate", 10.0, "Messages per second on /srg", "Hz", 0.1, 100)
        images = self.parameter("images", False, "Record images, too", changes=True)
        self.parameter("connect_timeout", 10.0, "Longest wait of /record for the sides' publishers to be matched", "s",
                       0, 3600, changes=True)  # fmt: skip
        reference = self.parameter("reference", [""], "Bags of real trials whose tunnels apply from the start")
        if not ks or min(ks) < 0 or len(set(ks)) != len(ks):
            self.complain(f"Parameter 'ks': expected different numbers of at least 0, got {list(ks)}.")
        if 0 < rate < LOWEST_RATE:
            self.complain(f"Parameter 'rate': expected 0, or at least {LOWEST_RATE:g} Hz, got {rate:g}.")
        self.check_parameters()
        self._asked = tuple(name for name in signals if name)
        self._fields = [
            suffix for suffix in SUFFIX_FIELDS if not suffix or any(name.endswith(suffix) for name in self._asked)
        ]
        self._max_gap = max_gap
        self._empty_gap = partial(
            LiveGap, self._units(), self._asked, ks=ks, k_sim=k_sim, max_gap=max_gap, smoothed=smoothed
        )
        self._reference = [read(typed_path(bag)) for bag in reference or () if bag]
        self._rate, self._own_rate = rate or RATE, not rate
        self._gap = self._gap_at(self._rate)
        self._counts: dict[str, StampCounts] = {}
        self._late_after = late
        self.add_post_set_parameters_callback(self._changed)
        # With a simulated clock, or that of a replay, this machine's own says nothing on how late a message came.
        self._sim_time = bool(self.get_parameter("use_sim_time").value)
        self._stamp, self._told_trials = 0, -1
        self._model: tuple[str, ...] | None = None
        self._recorder = Recorder(self, SIDES, self._received, images, self._sim_time)
        overridable = {"qos_overriding_options": QoSOverridingOptions.with_default_policies()}
        self._srg = self.create_publisher(Srg, "srg", 10, **overridable)
        self._tunnel = self.create_publisher(TunnelSample, "srg/tunnel", 100, **overridable)
        self._numbers: dict[str, Publisher] = {}
        self._diagnose = DiagnoseServer(self)
        self._counters = self.create_publisher(LiveCounters, "srg/counters", 10, **overridable)
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self._next_look: Future[None] | None = None
        self._stays_until = 0.0
        # Of its own, so that all else goes on while an answer waits.
        self.create_service(Record, "record", self._record, callback_group=MutuallyExclusiveCallbackGroup())
        self.create_timer(1 / srg_rate, self._tell_figures)
        self.create_timer(1.0, self._tell_health)

    def _changed(self, parameters: list[Parameter]) -> None:
        for parameter in parameters:
            if parameter.name == "images":
                self._recorder.images = bool(parameter.value)
            elif parameter.name == "late_after":
                self._late_after = float(parameter.value)
                for counts in self._counts.values():
                    counts.late_after = self._late_after

    @property
    def busy(self) -> bool:
        return self._diagnose.busy or self._next_look is not None or time.monotonic() < self._stays_until

    @property
    def poll_period(self) -> float:
        return TAKE_PERIOD

    def poll(self) -> None:
        self._recorder.take()
        if self._next_look is not None:
            self._next_look.set_result(None)

    def close(self) -> None:
        self._diagnose.close()
        for bag in self._recorder.bags:
            self.get_logger().info(f"Closing {bag}.")
        self._recorder.stop()
        if self._recorder.errors:
            self.exit_code = 1

    def _units(self) -> dict[str, str]:
        units = {
            name: SUFFIX_UNITS[suffix]
            for name in self._asked
            for suffix in SUFFIX_UNITS
            if suffix and name.endswith(suffix)
        }
        return {**units, "ball_x": "m", "ball_y": "m"}

    def _received(self, side: str, name: str, topic: str, raw: bytes, arrival: int) -> None:
        # Recording continues, whatever is sent.
        try:
            self._follow(side, name, topic, raw, arrival)
        except InputError as error:
            self.get_logger().warning(str(error), throttle_duration_sec=1.0)
        except rclpy_implementation.RMWError:
            self.get_logger().warning(f"Left out a message on {topic} that cannot be read.", throttle_duration_sec=1.0)

    def _follow(self, side: str, name: str, topic: str, raw: bytes, arrival: int) -> None:
        if name == "trial":
            self._marked(side, deserialize_message(raw, Trial), topic)
        elif name == "joint_states":
            message = deserialize_message(raw, JointState)
            stamp = nanoseconds(message.header.stamp)
            if self._counted(side, topic, stamp, arrival):
                names, values = self._joint_values(message)
                self._judged(self._gap.add(side, name, names, stamp, values))
        elif name == "ball":
            ball = deserialize_message(raw, BallState)
            stamp = nanoseconds(ball.header.stamp)
            # Where the ball is not seen there is no measurement; a gap follows.
            if self._counted(side, topic, stamp, arrival) and ball.visible:
                self._judged(self._gap.add(side, name, BALL_SIGNALS, stamp, np.array([ball.x, ball.y])))
        elif name == "model" and side == "sim":
            self._note_model(deserialize_message(raw, RunningModel))

    def _joint_values(self, message: JointState) -> tuple[tuple[str, ...], np.ndarray]:
        names: list[str] = []
        values: list[float] = []
        for suffix in self._fields:
            column = getattr(message, SUFFIX_FIELDS[suffix])
            if len(column) == len(message.name):
                names += [f"{joint}{suffix}" for joint in message.name]
                values += column
        return tuple(names), np.array(values)

    def _gap_at(self, rate: float) -> LiveGap:
        """A gap with only the trials of the reference. Raises InputError for a bag that has no real trials."""
        gap = self._empty_gap(rate=rate)
        if not self._reference:
            return gap
        plays = to_plays(self._reference, namespace="/real", rate=rate, max_gap=self._max_gap)
        for play, result in zip(plays.plays, plays.results, strict=True):
            if not result.sequence_hash:
                raise InputError(
                    f"reference: {play.name} has no marks that name a sequence; expected bags with marked trials."
                )
            gap.refer_to(result.sequence_hash, play.trials)
            self.get_logger().info(f"{play.trials.count} trials of {play.name} are the reference.")
        return gap

    def _counted(self, side: str, topic: str, stamp: int, arrival: int) -> bool:
        if self._sim_time:
            arrival = self.get_clock().now().nanoseconds
        if topic not in self._counts:
            self._counts[topic] = StampCounts(late_after=self._late_after)
        counts = self._counts[topic]
        jumps = counts.clock_jumps
        in_order = counts.add(stamp, arrival)
        if counts.clock_jumps > jumps:
            self._gap.jumped(side)
            self.get_logger().warning(f"The stamps on {topic} jumped; the running trial of that side is left out.")
        return in_order

    def _marked(self, side: str, message: Trial, topic: str) -> None:
        mark = TrialMark(
            stamp=nanoseconds(message.header.stamp), topic=topic, phase=PHASES.get(message.phase, "aborted"),
            trial=message.trial, sequence=message.sequence, sequence_hash=message.sequence_hash,
            duration=message.duration,
        )  # fmt: skip
        if mark.phase == "start":
            self._judged(self._gap.start(side, mark))
        elif mark.phase == "end":
            self._gap.end(side, mark)
        else:
            self._gap.abort(side)

    def _judged(self, batches: list[Judged]) -> None:
        for batch in batches:
            self._stamp = batch.stamp
            tunnel = batch.real
            # After a pause many samples are judged at once; the newest gives the current state.
            row = len(tunnel.time) - 1
            message = TunnelSample(
                time=float(tunnel.time[row]), signals=list(tunnel.signals), mean=array("d", tunnel.mean[row]),
                lower=array("d", tunnel.lower[row]), upper=array("d", tunnel.upper[row]),
                simulated=array("d", batch.simulated[row]), alike=batch.alike[row].tolist(),
            )  # fmt: skip
            message.header.stamp = to_time(batch.stamp)
            self._tunnel.publish(message)

    def _tell_figures(self) -> None:
        figures = self._gap.figures()
        if figures is None:
            return
        message = Srg(
            signals=list(figures.signals), k=list(figures.ks), alikeness=figures.shares.ravel().tolist(),
            joint=figures.joint.tolist(), samples=figures.samples, trials=figures.trials,
            rig_alikeness=figures.itself.ravel().tolist() if figures.yardstick else [],
            rig_joint=figures.itself_joint.tolist() if figures.yardstick else [],
        )  # fmt: skip
        message.header.stamp = to_time(self._stamp)
        self._srg.publish(message)
        self._tell_numbers(figures)
        if figures.complete and figures.trials != self._told_trials:
            self._told_trials = figures.trials
            shares = ", ".join(
                f"k={k:g} {100 * share:.1f} %" for k, share in zip(figures.ks, figures.joint, strict=True)
            )
            if figures.yardstick:
                rig = ", ".join(f"{100 * share:.1f} %" for share in figures.itself_joint)
                shares += f"; the rig against itself {rig}"
            self.get_logger().info(f"{figures.command}: {figures.trials} trials, jointly alike {shares}.")

    def _tell_numbers(self, figures: Figures) -> None:
        first = figures.ks.index(min(figures.ks))
        for row, signal in enumerate(figures.signals):
            if not WORD.fullmatch(signal):  # the name of a joint, which ROS leaves free; no topic can have it
                continue
            if signal not in self._numbers:
                self._numbers[signal] = self.create_publisher(Float64, f"srg/{signal}/alikeness", 10)
            self._numbers[signal].publish(Float64(data=float(figures.shares[row, first])))

    async def _matched(self, sides: Sequence[str]) -> list[str]:
        """Waits until all publishers are matched, and returns those that are not, in words."""
        deadline = time.monotonic() + float(self.get_parameter("connect_timeout").value or 0.0)
        while True:
            self._recorder.look()
            missing = self._recorder.missing(sides)
            if (not missing and self._recorder.settled) or time.monotonic() >= deadline:
                return missing
            if self.stopping.is_set():
                self._stays_until = time.monotonic() + FAREWELL
                raise InputError("The analysis node is being stopped.")
            self._next_look = Future()
            await self._next_look
            self._next_look = None

    async def _record(self, request: Record.Request, response: Record.Response) -> Record.Response:
        try:
            if request.start:
                if not request.folder or not request.label or "/" in request.label:
                    raise InputError("Give a `folder`, and a `label` without '/', for the bags to record.")
                metadata = {"sequence": request.sequence, "sequence_hash": request.sequence_hash}
                self._recorder.check(request.sides)
                missing = await self._matched(request.sides)
                folder = typed_path(request.folder)
                response.bags = self._recorder.start(folder, request.label, metadata, request.sides)
                response.message = f"Recording {', '.join(response.bags)}."
                if missing:
                    response.message += f" Not matched yet: {', '.join(missing)}."
            else:
                if not self._recorder.bags:
                    raise InputError("Nothing is being recorded.")
                response.bags = self._recorder.stop()
                if self._recorder.errors:
                    raise InputError(self._recorder.errors)
                response.message = f"Recorded {', '.join(response.bags)}."
            response.success = True
            self.get_logger().info(response.message)
        except InputError as error:
            response.success, response.message = False, " ".join(error.complaints)
            self.get_logger().error(response.message)
        return response

    def _note_model(self, model: RunningModel) -> None:
        """Bags name the simulation's model, and trials of another one do not count."""
        self._recorder.model = model.name
        now = (model.name, model.file, str(model.loaded))
        before, self._model = self._model, now
        if before == now:
            return
        rate = _rate_of(model.file) if self._own_rate else self._rate
        if rate != self._rate:
            self._rate, self._gap, self._told_trials = rate, self._gap_at(rate), -1
            self.get_logger().info(f"Both sides are compared at {rate:g} Hz, as '{model.name}' says of its rig.")
        if before is not None:
            self._gap.forget("sim")
            self._told_trials = -1
            self.get_logger().info(f"The simulation runs '{model.name}' now; its earlier trials are left out.")

    def _tell_health(self) -> None:
        self._recorder.look()
        now = self.get_clock().now().to_msg()
        topics = sorted(self._counts)
        counts = [self._counts[topic] for topic in topics]
        message = LiveCounters(
            topics=topics, received=[c.received for c in counts], late=[c.late for c in counts],
            lost=[c.lost for c in counts], reordered=[c.reordered for c in counts],
            duplicated=[c.duplicated for c in counts],
            restarts=sum(self._recorder.restarts.get(topic, 0) for topic in topics),
            clock_jumps=sum(c.clock_jumps for c in counts),
        )  # fmt: skip
        message.header.stamp = now
        self._counters.publish(message)
        troubled = [topic for topic, c in zip(topics, counts, strict=True) if c.troubled]
        level = DiagnosticStatus.WARN if troubled else DiagnosticStatus.OK
        text = f"samples went wrong on {', '.join(troubled)}" if troubled else "all samples in order"
        samples = DiagnosticStatus(level=level, name=f"{self.full_name}: samples", message=text)
        for topic, c in zip(topics, counts, strict=True):
            samples.values.append(KeyValue(key=topic, value=str(c)))
        errors, bags = self._recorder.errors, self._recorder.bags
        recording = DiagnosticStatus(
            level=DiagnosticStatus.ERROR if errors else DiagnosticStatus.OK,
            name=f"{self.full_name}: recording",
            message=" ".join(errors) or ("recording" if bags else "not recording"),
            values=[KeyValue(key="bag", value=bag) for bag in bags],
        )
        diagnostics = DiagnosticArray(status=[samples, recording])
        diagnostics.header.stamp = now
        self._diagnostics.publish(diagnostics)


def _rate_of(file: str) -> float:
    """Rate, Hz, of the rig of a model's file; RATE if this machine cannot read the file."""
    try:
        return load_model(file).rig.rate if file else RATE
    except InputError:
        return RATE


def main(args: list[str] | None = None) -> int:
    """Entry point of `ros2 run eps_tunnel_analysis analysis_node`."""
    return run_node(
        "analysis_node", "Records both sides, and follows the gap between them while they run.", AnalysisNode, args
    )


if __name__ == "__main__":
    sys.exit(main())
