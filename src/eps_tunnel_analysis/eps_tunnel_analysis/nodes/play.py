# SPDX-License-Identifier: Apache-2.0
"""The course of one run: return to the initial pose, wait for rest, play, mark, and so on for every trial."""

import math
import sys
import time
from collections.abc import Callable, Iterator
from collections.abc import Sequence as SequenceOf
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType

import numpy as np
from rclpy.node import Node
from tqdm import tqdm

from eps_tunnel_analysis.motion import Array, smooth_path
from eps_tunnel_analysis.nodes.messages import to_time
from eps_tunnel_analysis.nodes.pace import JUMP, ClockJumped, Pace
from eps_tunnel_analysis.nodes.rig_side import RecordClient, RigSide
from eps_tunnel_analysis.sequence import Command, Sequence
from labyrinth_msgs.msg import Trial
from labyrinth_sim.config import typed_path
from labyrinth_sim.errors import InputError

FEEDBACK = 0.2  # s between two reports of progress
TAIL = 0.3  # s of recording after each trial, so that its last sample has a neighbour to interpolate with
REPEATS = 3  # times a trial is restarted after a stall of this process
STALE = 10.0  # s between the stamps of a side and the player's clock from which both cannot be meant to be one
MOST_TRIALS = 100_000  # of each command; the parameter's bound, which the reference reads as it stands
RECORD_TIMEOUT = 60.0  # s; a slow disk and a busy machine need some to close a bag


@dataclass(frozen=True)
class Progress:
    """trial: from 0, over all commands; phase: returning, settling, playing or recording; share: 0..1; time_left: s."""

    trial: int
    trials: int
    phase: str
    share: float
    time_left: float


class ProgressBar:
    """A bar on stderr, from 0 to 100 %; if that is not a terminal, a line at each change of phase."""

    def __init__(self) -> None:
        self._told = ""
        self._bar = tqdm(
            total=100,
            bar_format="{desc}{percentage:3.0f}% |{bar}|{postfix}",
            file=sys.stderr,
            dynamic_ncols=True,
            leave=True,
            disable=None,  # where stderr is no terminal
        )

    def __enter__(self) -> "ProgressBar":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bar.close()

    def show(self, progress: Progress) -> None:
        doing = f"trial {progress.trial + 1}/{progress.trials} {progress.phase}"
        remaining = f"{progress.time_left:.0f} s left"
        if not self._bar.disable:
            self._bar.set_description_str(f"{doing:25}", refresh=False)
            self._bar.set_postfix_str(remaining, refresh=False)
            self._bar.update(100 * progress.share - self._bar.n)
        elif doing != self._told:
            print(f"{doing}, {100 * progress.share:.0f} %, {remaining}", file=sys.stderr, flush=True)
        self._told = doing


@dataclass(frozen=True)
class Grid:
    """Even ticks on two clocks: tick 0 is at `begin` (the run's, s) and at `begin_ns` (the node's, ns)."""

    begin: float
    begin_ns: int
    rate: float

    def moment(self, tick: int) -> float:
        """s, of the run's clock."""
        return self.begin + tick / self.rate

    def stamp(self, tick: int) -> int:
        """ns of the node's clock."""
        return self.begin_ns + round(tick / self.rate * 1e9)

    def newest(self, now: float) -> int:
        """The last tick up to `now`, s of the run's clock."""
        return int((now - self.begin) * self.rate)


class RunEnded(Exception):
    """The run cannot go on; the text says why."""


class Run:
    """State of a run: its clock, its progress, whether it must stop. Times are s of its clock.

    Attributes:
        hopeless: says why the run cannot go on, or nothing.
    """

    def __init__(
        self, sequence: Sequence, trials: int, pace: Pace, report: Callable[[Progress], None],
        stopped: Callable[[], bool],
    ) -> None:  # fmt: skip
        self._report, self._stopped, self.pace = report, stopped, pace
        self.hopeless: Callable[[], str] = lambda: ""
        # A first guess of 2.5 s between trials; later the run's own pace counts.
        self._work = [command.duration + 2.5 for command in sequence.commands for _ in range(trials)]
        self.trial, self.trials, self.phase = 0, len(self._work), "returning"
        self.lateness: list[float] = []
        self._began = self._trial_began = self.awake = pace.now()
        self.next_tick = 0.0
        self._next_report = 0.0

    def check(self) -> None:
        if self._stopped():
            raise RunEnded("it was cancelled.")
        if reason := self.hopeless():
            raise RunEnded(reason)

    def wait(self, tick: float) -> None:
        """Sleeps until a tick."""
        self.check()
        try:
            self.pace.wait(tick, self.check)
        except ClockJumped as jumped:
            raise RunEnded(str(jumped)) from jumped
        self.lateness.append(self.pace.now() - tick)

    def trial_done(self) -> None:
        self.trial += 1
        self._trial_began = self.pace.now()

    def report(self, now: float) -> None:
        if now < self._next_report:
            return
        self._next_report = now + FEEDBACK
        total, done = sum(self._work), sum(self._work[: self.trial])
        spent = now - self._began
        within = min(now - self._trial_began, self._work[min(self.trial, self.trials - 1)])
        share = min(1.0, (done + within) / total) if self.trial < self.trials else 1.0
        pace = spent / (done + within) if self.trial and done + within > 0 else 1.0
        self._report(
            Progress(min(self.trial, self.trials - 1), self.trials, self.phase, share, (1 - share) * total * pace)
        )


@dataclass(frozen=True)
class Limits:
    """angle: rad; speed: rad/s; the others s."""

    angle: float
    speed: float
    rest_timeout: float
    silence: float
    connect_timeout: float
    stall: float


@dataclass(frozen=True)
class Outcome:
    """Result of a run; bags: paths of what was recorded, also of a run that ended early."""

    success: bool
    message: str
    bags: tuple[str, ...]


class Stalled(RunEnded):
    """This process got no processor time for so long that the commands of the trial differ from the sequence."""


class SequencePlayer:
    """Plays sequences on all sides from one clock: the same tick, the same stamp."""

    def __init__(
        self, node: Node, sides: SequenceOf[RigSide], recorder: RecordClient, pace: Pace, rate: float, limits: Limits
    ) -> None:
        """`rate` (Hz) and `limits` may change between two runs."""
        self._log = node.get_logger()
        self._pace = pace
        self._namespace = node.get_namespace().strip("/")
        self._sides, self._recorder, self.rate, self.limits = sides, recorder, rate, limits

    def check(self, sequence: Sequence) -> None:
        """Raises InputError when the sequence leaves the limits."""
        bound = (-self.limits.angle, self.limits.angle)
        sequence.check_limits({channel: bound for command in sequence.commands for channel in command.channels})

    def play(
        self, sequence: Sequence, trials: int, record: bool, folder: str,
        report: Callable[[Progress], None], stopped: Callable[[], bool],
    ) -> Outcome:  # fmt: skip
        """Plays every command of the sequence `trials` times (0: as it says); one bag per side and command.

        Raises InputError before anything moves.
        """
        self.check(sequence)
        trials = trials or sequence.trials
        if trials > MOST_TRIALS:
            raise InputError(f"{trials} trials of each command; expected at most {MOST_TRIALS}.")
        run = Run(sequence, trials, self._pace, report, stopped)
        bags: list[str] = []
        for side in self._sides:
            side.target = None
        try:
            self._connect(sequence.commands[0], run)
            run.hopeless = self._clock_gone
            target_folder = (
                (typed_path(folder) if folder else _free_path(self._namespace, sequence.name)) if record else None
            )
            for command in sequence.commands:
                with self._recording(target_folder, command, bags, run):
                    for number in range(trials):
                        self._whole_trial(command, number, run)
        except (RunEnded, InputError) as reason:
            trial = min(run.trial + 1, run.trials)
            return Outcome(False, f"{sequence.name} ended in trial {trial} of {run.trials}: {reason}", tuple(bags))
        late = 1000 * np.array(run.lateness)
        return Outcome(
            True,
            f"Played {sequence.name}: {run.trials} trials on {', '.join(side.name for side in self._sides)}. "
            f"Commands were {np.median(late):.2f} ms late in the median, {np.percentile(late, 99):.2f} ms at 99 %, "
            f"{late.max():.2f} ms at most.",
            tuple(bags),
        )

    def _connect(self, command: Command, run: Run) -> None:
        """Waits until every side listens and publishes joint states."""
        deadline = time.monotonic() + self.limits.connect_timeout
        while missing := [reason for side in self._sides if (reason := self._missing(side, command))]:
            if time.monotonic() > deadline:
                raise RunEnded(" ".join(missing) + " Start the node of that side, or leave the side out by `sides`.")
            run.check()
            time.sleep(0.02)

    def _clock_gone(self) -> str:
        """Why a simulated clock will not continue; empty if it may, as after a pause."""
        gone = [side for side in self._sides if self._pace.simulated and not side.measured]
        return f"{gone[0].name} fell silent: nothing publishes {gone[0].topics[1]} any more." if gone else ""

    def _missing(self, side: RigSide, command: Command) -> str:
        commands, states = side.topics
        if not self._pace.nanoseconds():
            return "No time on /clock, which use_sim_time:=true asks for."
        if not side.listeners:
            return f"Nothing subscribes to {commands}."
        if side.silence > self.limits.silence:
            return f"No joint states on {states}."
        if side.stamp and abs(ahead := side.stamp - self._pace.nanoseconds() * 1e-9) > STALE:
            return (
                f"The stamps on {states} are {ahead:+.0f} s from this node's clock. Where the simulation publishes "
                "/clock, give player and analysis node use_sim_time:=true; else set the clocks of both machines."
            )
        absent = [channel for channel in command.channels if not math.isfinite(side.positions.get(channel, math.nan))]
        return f"{states} lacks {', '.join(absent)}; it has {', '.join(side.positions)}." if absent else ""

    @contextmanager
    def _recording(self, folder: Path | None, command: Command, bags: list[str], run: Run) -> Iterator[None]:
        if folder is None:
            yield
            return
        bags.extend(self._recorder.start(folder, command, self.limits.connect_timeout, RECORD_TIMEOUT, run.check))
        try:
            yield
        finally:
            self._recorder.stop(self.limits.connect_timeout, RECORD_TIMEOUT)

    def _whole_trial(self, command: Command, number: int, run: Run) -> None:
        """A trial; one that was spoiled by a stall is marked as aborted and restarted."""
        for repeat in range(REPEATS + 1):
            try:
                self._trial(command, number, run)
                return
            except Stalled as stall:
                if repeat == REPEATS:
                    raise
                self._log.warning(f"Trial {number + 1} of {command.name} is aborted and started again: {stall}")

    def _trial(self, command: Command, number: int, run: Run) -> None:
        initial = np.array(command.initial)
        paths = [smooth_path(side.pose(command), initial, self.limits.speed, self.rate) for side in self._sides]
        steps = max(len(path) for path in paths)
        paths = [np.vstack([path, np.repeat(path[-1:], steps - len(path), axis=0)]) for path in paths]
        run.phase = "returning"
        self._tick(command, paths, run)
        run.phase = "settling"
        self._settle(command, initial, run)
        run.phase = "playing"
        _, targets = command.sample(self.rate)
        started = False

        def mark(phase: int, stamp_ns: int) -> None:
            nonlocal started
            started = phase == Trial.START
            for side in self._sides:
                side.mark(to_time(stamp_ns), phase, command, number)

        try:
            grid = self._tick(command, [targets] * len(self._sides), run, lambda ns: mark(Trial.START, ns), True)
            mark(Trial.END, grid.begin_ns + round(command.duration * 1e9))
        finally:
            if started:
                mark(Trial.ABORTED, self._pace.nanoseconds())
        run.phase = "recording"
        run.trial_done()
        tail = np.repeat(targets[-1:], math.ceil(TAIL * self.rate), axis=0)
        done = max(len(targets), grid.newest(self._pace.now()) + 1)
        self._tick(command, [tail] * len(self._sides), run, grid=grid, done=done)

    def _settle(self, command: Command, pose: Array, run: Run) -> None:
        for side in self._sides:
            side.rest.reset()
        deadline = self._pace.now() + self.limits.rest_timeout
        hold = np.repeat(pose[None], max(1, round(0.05 * self.rate)), axis=0)
        while not all(side.rest.at_rest for side in self._sides):
            if self._pace.now() > deadline:
                moving = "; ".join(side.restless() for side in self._sides if not side.rest.at_rest)
                raise RunEnded(
                    f"not at rest after {self.limits.rest_timeout:g} s ({moving}). Look for oscillation or noise, or "
                    "raise `rest_speed_deg` or `rest_timeout`."
                )
            self._tick(command, [hold] * len(self._sides), run)

    def _tick(
        self,
        command: Command,
        rows: SequenceOf[Array],
        run: Run,
        first: Callable[[int], None] | None = None,
        strict: bool = False,
        grid: Grid | None = None,
        done: int = 0,
    ) -> Grid:
        """Sends row after row to each side, one per tick; returns the ticks' grid.

        Ticks are those of a new grid that begins now, or of a given one after its first `done`. They are absolute, so
        that a late tick does not move those after it; rows whose time has passed are left out, as a held command
        would be. With `strict` more than `Limits.stall` of them are too many.
        """
        if grid is None:
            run.wait(max(run.next_tick, self._pace.now()))
            grid = Grid(*self._pace.both(), self.rate)
        else:
            run.wait(grid.moment(done))
        step = 0
        while step < len(rows[0]):
            now, ns = self._pace.both()
            drift = (ns - grid.begin_ns) * 1e-9 - (now - grid.begin)
            if abs(drift) > JUMP:
                raise RunEnded(f"the clock jumped by {drift:+.1f} s while playing.")
            self._check_silence(now, run)
            if step == 0 and first is not None:
                first(grid.begin_ns)
            # The stamp is that of the tick, not of the moment it was served: even steps of time, whatever the load.
            stamp = to_time(grid.stamp(done + step))
            for side, targets in zip(self._sides, rows, strict=True):
                side.send(stamp, command, targets[step])
            run.report(now)
            run.next_tick = grid.moment(done + step + 1)
            if step + 1 < len(rows[0]):
                run.wait(run.next_tick)
            due = grid.newest(self._pace.now()) - done
            if strict and due - step - 1 > self.limits.stall * self.rate:
                raise Stalled(
                    f"the player got no processor time for {(due - step) / self.rate:.2f} s; the machine is too busy. "
                    "Close other programs, or raise `stall_timeout`."
                )
            step = max(step + 1, due)
        return grid

    def _check_silence(self, now: float, run: Run) -> None:
        """Raises Ended if a side fell silent while this process could have received from it."""
        if now - run.awake > self.limits.stall:
            for side in self._sides:
                side.excuse(now)
        run.awake = now
        for side in self._sides:
            if side.silence > self.limits.silence:
                raise RunEnded(
                    f"{side.name} fell silent: no joint states for {side.silence:.1f} s on {side.topics[1]}."
                )


def _free_path(namespace: str, name: str) -> Path:
    """out/NAMESPACE/NAME-N with the first free N from 1; the recorder creates it."""
    number = 1
    while (folder := Path("out") / namespace / f"{name.replace('/', '_')}-{number}").exists():
        number += 1
    return folder
