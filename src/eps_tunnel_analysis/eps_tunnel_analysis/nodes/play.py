# SPDX-License-Identifier: Apache-2.0
"""The course of one run: return to the initial pose, wait for rest, play, mark, and so on for every trial."""

import math
import time
from collections.abc import Callable, Iterator
from collections.abc import Sequence as SequenceOf
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rclpy.node import Node

from eps_tunnel_analysis.motion import Array, smooth_path
from eps_tunnel_analysis.nodes.message_times import to_time
from eps_tunnel_analysis.nodes.progress import Progress
from eps_tunnel_analysis.nodes.record_client import RecordClient
from eps_tunnel_analysis.nodes.rig_side import RigSide
from eps_tunnel_analysis.nodes.run_so_far import Ended, Run
from eps_tunnel_analysis.nodes.ticks import Grid, both_clocks
from eps_tunnel_analysis.sequence import Command, Sequence
from labyrinth_msgs.msg import Trial
from labyrinth_sim.errors import InputError

TAIL = 0.3  # s of recording after each trial, so that its last sample has a neighbour to interpolate with
REPEATS = 3  # times a trial is begun anew after a stall of this process
RECORD_TIMEOUT = 60.0  # s; a slow disk and a busy machine need some to close a bag


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
    """What became of a run; bags: paths of what was recorded, also of a run that ended early."""

    success: bool
    message: str
    bags: tuple[str, ...]


class Stalled(Ended):
    """This process was not served for so long that the commands of the trial were not those of the sequence."""


class Play:
    """Plays sequences on all sides from one clock: the same tick, the same stamp."""

    def __init__(
        self, node: Node, sides: SequenceOf[RigSide], recorder: RecordClient, rate: float, limits: Limits
    ) -> None:
        self._clock, self._log = node.get_clock(), node.get_logger()
        self._sides, self._recorder, self._rate, self._limits = sides, recorder, rate, limits

    def check(self, sequence: Sequence) -> None:
        """Raises InputError when the sequence leaves the limits."""
        bound = (-self._limits.angle, self._limits.angle)
        sequence.check_limits({channel: bound for command in sequence.commands for channel in command.channels})

    def play(
        self, sequence: Sequence, trials: int, record: bool, folder: str,
        tell: Callable[[Progress], None], stopped: Callable[[], bool],
    ) -> Outcome:  # fmt: skip
        """Plays every command of the sequence `trials` times (0: as it says); one bag per side and command.

        Raises InputError for what is wrong before anything moves.
        """
        self.check(sequence)
        trials = trials or sequence.trials
        run = Run(sequence, trials, tell, stopped)
        bags: list[str] = []
        for side in self._sides:
            side.target = None
        try:
            self._connect(sequence.commands[0], run)
            target_folder = (Path(folder).expanduser() if folder else _free_path(sequence.name)) if record else None
            for command in sequence.commands:
                with self._recording(target_folder, command, bags):
                    for number in range(trials):
                        self._whole_trial(command, number, run)
        except (Ended, InputError) as reason:
            trial = min(run.trial + 1, run.trials)
            return Outcome(False, f"{sequence.name} ended in trial {trial} of {run.trials}: {reason}", tuple(bags))
        late = 1000 * np.array(run.lateness)
        return Outcome(
            True,
            f"Played {sequence.name}: {run.trials} trials on {', '.join(side.name for side in self._sides)}. "
            f"Commands were {np.median(late):.2f} ms late in the middle, {np.percentile(late, 99):.2f} ms at 99 %, "
            f"{late.max():.2f} ms at most.",
            tuple(bags),
        )

    def _connect(self, command: Command, run: Run) -> None:
        """Waits until every side listens and tells where its joints are."""
        deadline = time.monotonic() + self._limits.connect_timeout
        while missing := [reason for side in self._sides if (reason := self._missing(side, command))]:
            if time.monotonic() > deadline:
                raise Ended(" ".join(missing) + " Start the node of that side, or leave the side out by `sides`.")
            run.check()
            time.sleep(0.02)

    def _missing(self, side: RigSide, command: Command) -> str:
        commands, states = side.topics
        if not side.listeners:
            return f"Nobody listens to {commands}."
        if side.silence > self._limits.silence:
            return f"No joint states on {states}."
        absent = [channel for channel in command.channels if not math.isfinite(side.positions.get(channel, math.nan))]
        return f"{states} lacks {', '.join(absent)}; it has {', '.join(side.positions)}." if absent else ""

    @contextmanager
    def _recording(self, folder: Path | None, command: Command, bags: list[str]) -> Iterator[None]:
        if folder is None:
            yield
            return
        bags.extend(self._recorder.start(folder, command, RECORD_TIMEOUT))
        try:
            yield
        finally:
            self._recorder.stop(RECORD_TIMEOUT)

    def _whole_trial(self, command: Command, number: int, run: Run) -> None:
        """A trial; one that a stall spoiled is marked as given up and begun anew."""
        for repeat in range(REPEATS + 1):
            try:
                self._trial(command, number, run)
                return
            except Stalled as stall:
                if repeat == REPEATS:
                    raise
                self._log.warning(f"Trial {number + 1} of {command.name} is given up and begun anew: {stall}")

    def _trial(self, command: Command, number: int, run: Run) -> None:
        initial = np.array(command.initial)
        paths = [smooth_path(side.pose(command), initial, self._limits.speed, self._rate) for side in self._sides]
        steps = max(len(path) for path in paths)
        paths = [np.vstack([path, np.repeat(path[-1:], steps - len(path), axis=0)]) for path in paths]
        run.phase = "returning"
        self._tick(command, paths, run)
        run.phase = "settling"
        self._settle(command, initial, run)
        run.phase = "playing"
        _, targets = command.sample(self._rate)
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
                mark(Trial.ABORTED, self._clock.now().nanoseconds)
        run.phase = "recording"
        run.trial_done()
        tail = np.repeat(targets[-1:], math.ceil(TAIL * self._rate), axis=0)
        done = max(len(targets), grid.newest(time.monotonic()) + 1)
        self._tick(command, [tail] * len(self._sides), run, grid=grid, done=done)

    def _settle(self, command: Command, pose: Array, run: Run) -> None:
        for side in self._sides:
            side.rest.reset()
        deadline = time.monotonic() + self._limits.rest_timeout
        hold = np.repeat(pose[None], max(1, round(0.05 * self._rate)), axis=0)
        while not all(side.rest.at_rest for side in self._sides):
            if time.monotonic() > deadline:
                moving = "; ".join(side.restless() for side in self._sides if not side.rest.at_rest)
                raise Ended(
                    f"not at rest after {self._limits.rest_timeout:g} s ({moving}). Look for oscillation or noise, or "
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
        """Sends row after row to each side, one a tick; returns the ticks' grid.

        Ticks are those of a new grid that begins now, or of a given one after its first `done`. They are absolute, so
        that a late tick does not move those after it; rows whose time passed meanwhile are left out, as a held command
        would be. With `strict` more than `Limits.stall` of them are too many.
        """
        if grid is None:
            run.wait(max(run.next_tick, time.monotonic()))
            grid = Grid(*both_clocks(self._nanoseconds), self._rate)
        else:
            run.wait(grid.moment(done))
        step = 0
        while step < len(rows[0]):
            now, ns = both_clocks(self._nanoseconds)
            drift = (ns - grid.begin_ns) * 1e-9 - (now - grid.begin)
            if abs(drift) > 1.0:
                raise Ended(f"the clock jumped by {drift:+.1f} s while playing.")
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
            due = grid.newest(time.monotonic()) - done
            if strict and due - step - 1 > self._limits.stall * self._rate:
                raise Stalled(
                    f"the player was not served for {(due - step) / self._rate:.2f} s; the machine is too busy. Close "
                    "other programs, or raise `stall_timeout`."
                )
            step = max(step + 1, due)
        return grid

    def _nanoseconds(self) -> int:
        return int(self._clock.now().nanoseconds)

    def _check_silence(self, now: float, run: Run) -> None:
        """Raises Ended when a side fell silent while this process could have heard it."""
        if now - run.awake > self._limits.stall:
            for side in self._sides:
                side.excuse(now)
        run.awake = now
        for side in self._sides:
            if side.silence > self._limits.silence:
                raise Ended(f"{side.name} fell silent: no joint states for {side.silence:.1f} s on {side.topics[1]}.")


def _free_path(name: str) -> Path:
    """out/NAME-N with the first N from 1 that is free; the recorder makes it once it records."""
    number = 1
    while (folder := Path("out") / f"{name.replace('/', '_')}-{number}").exists():
        number += 1
    return folder
