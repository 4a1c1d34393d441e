# SPDX-License-Identifier: Apache-2.0
"""Serves the web page, and carries out its requests."""

import argparse
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from rclpy.action import ActionClient
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState

from eps_tunnel_analysis.monitor.parts import Health, Pose, Scene, VerdictPart
from eps_tunnel_analysis.monitor.server import SHORTEST_TOKEN, MonitorServer, is_loopback, new_token
from eps_tunnel_analysis.monitor.session import Session
from eps_tunnel_analysis.monitor.state import RecentHealth, State, Steps
from eps_tunnel_analysis.nodes.answers import Meeting
from eps_tunnel_analysis.nodes.common import SIDES, TunnelNode, run_node
from eps_tunnel_analysis.nodes.messages import (
    PolledGroup,
    PolledTopic,
    deep,
    diagnosis_message,
    latched,
    nanoseconds,
    newest,
    reliable,
)
from eps_tunnel_analysis.nodes.rig_processes import EmulatedRig, hidden_in, hidden_in_words, rig_processes
from eps_tunnel_analysis.outputs import numbered_folder
from eps_tunnel_analysis.processes import ProcessDied, Processes
from labyrinth_msgs.action import PlaySequence
from labyrinth_msgs.msg import BallState, Diagnosis, LiveCounters, RunningModel, Srg, Trial, TunnelSample
from labyrinth_msgs.srv import LoadModel
from labyrinth_sim.config import typed_path
from labyrinth_sim.effect import effects
from labyrinth_sim.errors import InputError, unknown_name
from labyrinth_sim.model import load_model

ABOUT = "Serves a page that shows rig and simulation while they run."
LOOK_PERIOD = 0.1  # s between two looks at what came
PLAYER_GONE = 5.0  # s
SILENT = 1.0  # s without joint states after which a side is gone
BALL_GONE = 0.5  # s without a sight of the ball after which it is not drawn
ANALYSIS_SILENT = 4.0  # s


class Inputs:
    """Takes what came since the last poll and shows it.

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
        """Whether a side publishes joint states."""
        return side in self._poses and time.monotonic() - self._poses[side][0] < SILENT

    @property
    def analysed(self) -> bool:
        """Whether the analysis node is running."""
        return time.monotonic() - self._heard < ANALYSIS_SILENT

    def take(self) -> bool:
        """Returns whether the simulation has changed its model."""
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
                figures.rig_alikeness,
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
        """Whether the parts of a message are consistent; a foreign node may have sent it."""
        fits = whether(message)
        if not fits:
            text = f"Ignored a {type(message).__name__} whose arrays do not have as many numbers as it has signals."
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
    rig = len(figures.rig_alikeness), len(figures.rig_joint)
    return (len(figures.alikeness), len(figures.joint)) == (wanted, n) and rig in ((0, 0), (wanted, n))


def _fits_tunnel(sample: TunnelSample) -> bool:
    parts = (sample.mean, sample.lower, sample.upper, sample.simulated, sample.alike)
    return all(len(part) == len(sample.signals) for part in parts)


def _health(counters: LiveCounters) -> Health:
    return Health(
        received=sum(counters.received), late=sum(counters.late), lost=sum(counters.lost),
        reordered=sum(counters.reordered), duplicated=sum(counters.duplicated), restarts=counters.restarts,
        clock_jumps=counters.clock_jumps,
    )  # fmt: skip


def _verdict(message: Diagnosis, model: str) -> VerdictPart:
    """A verdict of another node."""
    pairs = zip(message.candidates, message.probabilities, strict=False)
    return VerdictPart(
        verdict=message.verdict, sentence=message.sentence, effects=tuple(message.effects),
        hypotheses=tuple((name, p, False) for name, p in pairs), where=(), coverage=message.coverage,
        held_out=(message.held_out_before, None, message.held_out_after), model=model,
        next_experiment=message.next_experiment,
        report="", notes=(),
    )  # fmt: skip


class PlayerClient:
    """One run at a time.

    Attributes:
        playing: whether one was requested and has not ended.
    """

    def __init__(
        self, node: Node, progress: Callable[[PlaySequence.Feedback], None],
        ended: Callable[[PlaySequence.Result], None],
    ) -> None:  # fmt: skip
        self._client = ActionClient(node, PlaySequence, "play_sequence")
        self._meeting = Meeting(node, self._client, "play_sequence")
        self._progress, self._ended = progress, ended
        self._handle: Any = None
        self._stop = False
        self.playing = False

    @property
    def ready(self) -> bool:
        """Whether the player is running, and knows this client."""
        return self._meeting.done()

    def play(self, sequence: str, trials: int, folder: Path) -> None:
        """Plays and records; calls `ended` at the end."""
        self.playing, self._handle, self._stop = True, None, False
        goal = PlaySequence.Goal(sequence=sequence, trials=trials, record=True, folder=str(folder))
        future: Any = self._client.send_goal_async(goal, feedback_callback=lambda m: self._progress(m.feedback))
        future.add_done_callback(self._answered)

    def stop(self) -> None:
        """Ends the run early."""
        self._stop = True
        if self._handle is not None:
            self._handle.cancel_goal_async()

    def lost(self) -> None:
        """The player disappeared; the end of its run will not be reported."""
        self._end(PlaySequence.Result(success=False, message="The player disappeared while it was playing."))

    def _answered(self, future: Any) -> None:
        handle = future.result()
        if not handle.accepted:
            self._end(PlaySequence.Result(success=False, message="The player is busy with another run."))
            return
        self._handle = handle
        if self._stop:
            handle.cancel_goal_async()
        result: Any = handle.get_result_async()
        result.add_done_callback(lambda f: self._end(f.result().result))

    def _end(self, result: PlaySequence.Result) -> None:
        if self.playing:
            self.playing, self._handle = False, None
            self._ended(result)


class SimulationClient:
    """Loads another model into the simulation."""

    def __init__(self, node: Node) -> None:
        self._client = node.create_client(LoadModel, "sim/load_model")

    def load(self, model: Path, answered: Callable[[bool, str], None]) -> None:
        """`answered` gets whether it does, and the simulation's message."""
        if not self._client.service_is_ready():
            answered(False, f"No node offers {self._client.service_name}. The model is in {model}.")
            return
        future: Any = self._client.call_async(LoadModel.Request(model=str(model)))
        future.add_done_callback(lambda f: answered(f.result().success, f.result().message))


class Monitor(TunnelNode):
    """Action client of play_sequence, client of sim/load_model; publishes its verdicts on srg/diagnosis."""

    def __init__(self, processes: Processes | None = None) -> None:
        super().__init__("monitor")
        self._processes = processes
        host = self.parameter("host", "127.0.0.1", "Address to listen on")
        port = self.parameter("port", 8765, "Port to listen on; 0 takes a free one", "-", 0, 65535)
        token = self.parameter("token", "", "Token that every page must present; empty: a new one at each start")
        ask_token = self.parameter("ask_token", True, "False lets every program of this machine drive the rig")
        folder = self.parameter("folder", "out", "Where monitor-N is made, for bags, diagnoses and models")
        model = self.parameter("model", "", "Model to diagnose; empty: the file that the simulation reports")
        candidates = self.parameter("candidates", [""], "Effects to consider in a diagnosis; empty: all") or []
        candidates = [name for name in candidates if name]
        if not ask_token and not is_loopback(host):
            self.complain(f"Parameter 'ask_token': host {host} lets other machines in, and they need a token.")
        if not ask_token and token:
            self.complain("Parameter 'ask_token': false, yet 'token' is given. Leave one of them out.")
        self._check(token, model, candidates)
        self._state = State()
        self._steps = Steps(self._state)
        self._inputs = Inputs(self, self._state, self._steps)
        self._player = PlayerClient(self, self._progressed, self._played)
        self._simulation = SimulationClient(self)
        self._verdicts = self.create_publisher(Diagnosis, "srg/diagnosis", latched())
        self._player_seen = time.monotonic()
        out = typed_path(folder).resolve()
        self._session = Session(self._state, self._steps, self, out, model, candidates)
        token = token or (new_token() if ask_token else "")
        self._server = MonitorServer(self._state, host, port, token, self._session.ask, self._session.reports)
        steady = Clock(clock_type=ClockType.STEADY_TIME)  # the page, and the end of a run, must not wait for /clock
        self.create_timer(LOOK_PERIOD, self._look, clock=steady)
        self.create_timer(1.0, self._check_processes, clock=steady)
        self.get_logger().info(f"Open {self._server.address}")

    @property
    def busy(self) -> bool:
        return self._player.playing

    def close(self) -> None:
        self._session.close()
        self._server.close()

    # What the session asks for.

    @property
    def ready(self) -> bool:
        """Whether the player is running."""
        return self._player.ready

    @property
    def playing(self) -> bool:
        """Whether a run was asked for and has not ended."""
        return self._player.playing

    @property
    def analysed(self) -> bool:
        """Whether the analysis node is running."""
        return self._inputs.analysed

    def alive(self, side: str) -> bool:
        """Whether a side publishes joint states."""
        return self._inputs.alive(side)

    def play(self, sequence: str, trials: int, folder: Path) -> None:
        """Starts a run with recording."""
        self._player.play(sequence, trials, folder)

    def stop(self) -> None:
        """Ends the player's run early."""
        self._player.stop()

    def load(self, model: Path) -> None:
        """Loads a model into the simulation."""
        self._simulation.load(model, self._session.loaded)

    def publish(self, verdict: dict[str, Any], report: str) -> None:
        """Publishes a verdict, also for later subscribers."""
        message = diagnosis_message(verdict, report)
        message.header.stamp = self.get_clock().now().to_msg()
        self._inputs.own_verdict = nanoseconds(message.header.stamp)
        self._verdicts.publish(message)

    def _check(self, token: str, model: str, candidates: list[str]) -> None:
        if token and len(token) < SHORTEST_TOKEN:
            self.complain(f"Parameter 'token': expected at least {SHORTEST_TOKEN} characters, got {len(token)}.")
        for name in candidates:
            if name not in effects():
                self.complain(f"Parameter 'candidates': {unknown_name('effect', name, effects())}")
        try:
            if model:
                load_model(model)
        except InputError as error:
            for complaint in error.complaints:
                self.complain(f"Parameter 'model': {complaint}")
        self.check_parameters()

    def _look(self) -> None:
        if self._inputs.take():
            self._session.show_rig()
        self._session.look(self._server.pages)
        now = time.monotonic()
        if self._player.ready or not self._player.playing:
            self._player_seen = now
        elif now - self._player_seen > PLAYER_GONE:
            self._player.lost()
        if self.stopping.is_set() and self._player.playing:
            self._player.stop()  # it could not be stopped any more

    def _check_processes(self) -> None:
        """Reports once that a process of the emulated rig has ended."""
        try:
            if self._processes is not None:
                self._processes.check()
        except ProcessDied as died:
            self._processes = None
            self._state.note(str(died), "error")

    def _progressed(self, feedback: PlaySequence.Feedback) -> None:
        f, duration = feedback, self._inputs.duration
        self._session.progress(f.trial, f.trials, f.phase, f.progress, f.time_left, duration)

    def _played(self, result: PlaySequence.Result) -> None:
        self._session.played(result.success, result.message, list(result.bags))


def parser() -> argparse.ArgumentParser:
    """Options of `ros2 run eps_tunnel_analysis monitor`, before its `--ros-args`."""
    p = argparse.ArgumentParser(
        prog="monitor",
        description="Serves a page that shows rig and simulation while they run, with buttons to play, diagnose "
        "and add. Uses the running nodes; with --emulated it starts its own rig.",
        epilog="Parameters, after --ros-args -p NAME:=VALUE: host, port, token, ask_token, folder, model, candidates.",
    )
    p.add_argument("--emulated", nargs="?", const="healthy", metavar="CONFIG", help="start an emulated rig of "
                   "config/testbed and config/hw (default: healthy), simulation, analysis and player")  # fmt: skip
    own = p.add_argument_group("with --emulated")
    own.add_argument("--hide", action="append", default=[], metavar="NAME[.AXIS][=STRENGTH]",
                     help="hide one more effect in the rig; ? picks one at random, revealed at the end")  # fmt: skip
    own.add_argument("--sim", default="labyrinth_mx64", metavar="M", help="model of the simulation (default: "
                     "%(default)s)")  # fmt: skip
    own.add_argument("--video", action="store_true", help="emulate the camera, too; takes most of a processor core")
    own.add_argument("--seed", type=int, default=1, help="of the rig's noise and of a draw (default: %(default)s)")
    own.add_argument("--out", type=Path, default=Path("out"), metavar="DIR", help="where rig-N is made for the logs "
                     "(default: %(default)s)")  # fmt: skip
    return p


def main(args: list[str] | None = None) -> int:
    """Entry point of `ros2 run eps_tunnel_analysis monitor`."""
    words = list(sys.argv[1:] if args is None else args)
    cut = words.index("--ros-args") if "--ros-args" in words else len(words)
    given, ros = parser().parse_args(words[:cut]), words[cut:]
    if given.emulated is None:
        return run_node("monitor", ABOUT, Monitor, ros)
    try:
        load_model(given.sim)
        signal.signal(signal.SIGTERM, signal.default_int_handler)
        folder = numbered_folder(given.out, "rig")
        rig = EmulatedRig(given.emulated, given.emulated, tuple(given.hide), given.seed, given.video)
        with rig_processes(rig, given.sim, folder) as processes:
            code = run_node("monitor", ABOUT, lambda: Monitor(processes), ros)
    except InputError as error:
        print(error, file=sys.stderr)
        return 2
    except ProcessDied as died:
        print(died, file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 130
    if given.hide:
        print(f"Hidden in the testbed: {hidden_in_words(hidden_in(folder))}. With values: {folder / 'hidden.json'}")
    return code


if __name__ == "__main__":
    sys.exit(main())
