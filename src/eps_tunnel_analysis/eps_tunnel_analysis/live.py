# SPDX-License-Identifier: Apache-2.0
"""The gap while it is measured: stamped samples of both sides in, judged samples and shares out.

Trials are put together on the grid that `recording` uses and judged by the functions that `compare` uses, so the
figures after a run are those computed from its bags.
"""

import math
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from eps_tunnel_analysis.alikeness import KS, AgainstItself, Alikeness, alikeness, rig_against_itself
from eps_tunnel_analysis.recording.recording import TrialMark
from eps_tunnel_analysis.recording.trials import MAX_GAP, MOST_SAMPLES, RATE
from eps_tunnel_analysis.stamped import interpolate
from eps_tunnel_analysis.tunnel import HALF_WIDTH, Tunnel, build_tunnel, smooth
from labyrinth_sim.errors import InputError
from labyrinth_sim.trials import Array, Trials

RELEARN = 50  # samples; the usual step between stamps is learned from that many
SECOND = 1_000_000_000  # ns
KEPT_SECONDS = 2.0
"""s of samples kept, for a start mark that comes after the samples it begins with"""
LARGEST = 1e12  # of any signal, SI; sums and squares of larger numbers are soon none
REAL, SIM = "real", "sim"


@dataclass(frozen=True)
class Judged:
    """Samples judged for the first time: the tunnel of reality and the simulation in it.

    Attributes:
        real: of the real trials so far, the running one included.
        simulated: (n, m) mean of the simulated trials.
        alike: (n, m) at k = 1.
        stamp: ns, of the last of the samples in the running trial.
    """

    real: Tunnel
    simulated: Array
    alike: NDArray[np.bool_]
    stamp: int


@dataclass(frozen=True)
class Figures:
    """Shares of alike samples (equation 7) of one command so far.

    Attributes:
        command: its name.
        signals: m names.
        ks: n factors of the real tunnel.
        shares: (m, n); NaN for a signal not seen on both sides.
        joint: (n,) of samples alike in every signal.
        samples: N, how many samples were judged.
        trials: how many real trials form the tunnel, the running one included.
        complete: whether no trial is running.
        itself: (m, n) shares that the rig reaches against itself by its finished trials; NaN while unknown.
        itself_joint: (n,) the same in every signal at once.
    """

    command: str
    signals: tuple[str, ...]
    ks: tuple[float, ...]
    shares: Array
    joint: Array
    samples: int
    trials: int
    complete: bool
    itself: Array
    itself_joint: Array

    @property
    def yardstick(self) -> bool:
        """Whether it is known what the rig reaches against itself."""
        return bool(np.isfinite(self.itself).any())


@dataclass
class StampCounts:
    """Counts over one topic.

    Attributes:
        late_after: s between measurement and arrival beyond which a message counts as late.
        jump: s between two stamps, or back, beyond which the clock has jumped rather than messages were lost.
    """

    late_after: float = 0.1
    jump: float = 5.0
    received: int = 0
    late: int = 0
    lost: int = 0
    reordered: int = 0
    duplicated: int = 0
    clock_jumps: int = 0

    def __post_init__(self) -> None:
        self._newest: int | None = None
        self._steps: list[int] = []
        self._period = 0

    @property
    def troubled(self) -> bool:
        """Whether samples were lost or out of order; late ones have all arrived."""
        return bool(self.lost or self.reordered or self.duplicated or self.clock_jumps)

    def __str__(self) -> str:
        return (
            f"{self.received} received, {self.late} late, {self.lost} lost, {self.reordered} reordered, "
            f"{self.duplicated} duplicated"
        )

    def add(self, stamp: int, arrival: int) -> bool:
        """Counts one message (ns both). False for one that is not after its predecessor and must not be judged."""
        self.received += 1
        if arrival - stamp > self.late_after * 1e9:
            self.late += 1
        if self._newest is None:
            self._newest = stamp
            return True
        step = stamp - self._newest
        if abs(step) > self.jump * 1e9:
            self.clock_jumps += 1
            self._newest, self._steps = stamp, []
            return True
        if step <= 0:
            if step == 0:
                self.duplicated += 1
            else:
                self.reordered += 1
            return False
        if self._period and step > 1.5 * self._period:
            self.lost += round(step / self._period) - 1
        self._steps.append(step)
        if len(self._steps) >= RELEARN:
            self._period, self._steps = int(np.median(self._steps)), []
        self._newest = stamp
        return True


@dataclass
class Stream:
    """Samples that come with one stamp: the joint states, or the ball."""

    names: tuple[str, ...]
    recent: deque[tuple[int, Array]] = field(default_factory=deque)

    @property
    def newest(self) -> int:
        return self.recent[-1][0] if self.recent else -1

    def add(self, stamp: int, values: Array) -> bool:
        """False for a sample that is not after its predecessor; it is dropped."""
        if stamp <= self.newest:
            return False
        self.recent.append((stamp, values))
        while len(self.recent) > 2 and self.recent[1][0] < stamp - KEPT_SECONDS * SECOND:
            self.recent.popleft()
        return True


class RunningTrial:
    """One running trial of one side on its grid."""

    def __init__(
        self, mark: TrialMark, signals: tuple[str, ...], streams: Mapping[str, Stream], rate: float, max_gap: float
    ) -> None:
        self.mark, self.signals, self._max_gap = mark, signals, max_gap
        self.time = np.arange(math.floor(mark.duration * rate + 1e-6) + 1) / rate
        self.grid = mark.stamp + np.round(self.time * 1e9).astype(np.int64)
        self.values = np.full((len(self.time), len(signals)), np.nan)
        self.ended = False
        # Only streams that were there at the start are waited for.
        self._streams = {key: stream for key, stream in streams.items() if stream.newest > mark.stamp - SECOND}
        for stream in streams.values():
            samples = list(stream.recent)
            for before, now in zip([None, *samples], samples, strict=False):
                self.add(stream.names, before, now)

    def add(self, names: Sequence[str], before: tuple[int, Array] | None, now: tuple[int, Array]) -> None:
        """Fills the grid points after the sample `before` up to the sample `now`."""
        known = [before, now] if before is not None else [now]
        first = int(np.searchsorted(self.grid, before[0], side="right")) if before is not None else 0
        last = int(np.searchsorted(self.grid, now[0], side="right"))
        if first >= last:
            return
        stamps = np.array([sample[0] for sample in known], dtype=np.int64)
        for column, name in enumerate(self.signals):
            if name in names:
                values = np.array([sample[1][names.index(name)] for sample in known])
                self.values[first:last, column] = interpolate(stamps, values, self.grid[first:last], self._max_gap)

    def ready(self) -> int:
        """How many grid points are final: every stream is past them, or silent for longer than a gap."""
        newest = [stream.newest for stream in self._streams.values()]
        if not newest:
            return 0
        known = max(min(newest), max(newest) - round(self._max_gap * 1e9))
        return int(np.searchsorted(self.grid, known, side="right"))


@dataclass
class _Command:
    """All that is known of one command: finished trials per side, and what was judged."""

    name: str
    time: Array
    signals: tuple[str, ...]
    finished: dict[str, list[Array]]
    alike: NDArray[np.bool_]  # (n, T, m)
    seen: NDArray[np.bool_]  # (T, m)
    itself: tuple[AgainstItself, ...] = ()


class LiveGap:
    """Follows the gap sample by sample.

    Args:
        units: signal -> SI unit, of all that may be compared.
        signals: those to compare; None takes what both sides measure when the first trial begins.
        rate: Hz of the grid.
        ks: factors of the real tunnel.
        k_sim: factor of the simulated one.
        max_gap: s; measurements further apart are not bridged.
        smoothed: filter the limits by equation 12. Within a running trial the samples to come are not in it yet;
            at its end all are judged again.
    """

    def __init__(
        self, units: Mapping[str, str] | None = None, signals: Sequence[str] | None = None, *, rate: float = RATE,
        ks: Sequence[float] = KS, k_sim: float = 1.0, max_gap: float = MAX_GAP, smoothed: bool = True,
    ) -> None:  # fmt: skip
        self._smoothed = smoothed
        self._units, self._signals = dict(units or {}), tuple(signals) if signals else None
        self._rate, self._ks, self._k_sim, self._max_gap = rate, tuple(ks), k_sim, max_gap
        self._references: dict[str, Trials] = {}
        self._streams: dict[str, dict[str, Stream]] = {REAL: {}, SIM: {}}
        self._running: dict[str, RunningTrial] = {}
        # Topics keep no order among each other: a trial's marks may come before the first samples of its side.
        self._early: dict[str, list[TrialMark]] = {}
        self._commands: dict[str, _Command] = {}
        self._current: _Command | None = None
        self._started: set[str] = set()
        self._judged = 0

    def refer_to(self, sequence_hash: str, trials: Trials) -> None:
        """Earlier real trials, on this grid: they count as if they had just been played."""
        self._references[sequence_hash] = trials

    def start(self, side: str, mark: TrialMark) -> list[Judged]:
        """A trial begins. One that still runs on this side is left out, as it has no end.

        Raises:
            InputError: it is said to last no time, or longer than a grid is made for; it is left out.
        """
        self.finish(side)
        self._running.pop(side, None)
        self._early.pop(side, None)
        if not 0 < mark.duration * self._rate <= MOST_SAMPLES:
            raise InputError(
                f"A mark on {mark.topic} says that its trial lasts {mark.duration:g} s; expected more than 0 and at "
                f"most {MOST_SAMPLES / self._rate:g} s. That trial is left out."
            )
        signals = self._signals_of(side, mark)
        if not signals:
            self._early[side] = [mark]
            return []
        trial = RunningTrial(mark, signals, self._streams[side], self._rate, self._max_gap)
        command = self._commands.get(mark.sequence_hash)
        if command is None:
            shape = (len(trial.time), len(signals))
            command = _Command(
                mark.sequence, trial.time, signals, {REAL: self._reference(mark, trial.time, signals), SIM: []},
                np.zeros((len(self._ks), *shape), dtype=np.bool_), np.zeros(shape, dtype=np.bool_),
            )  # fmt: skip
            command.itself = self._against_itself(command)
            self._commands[mark.sequence_hash] = command
        if len(command.time) != len(trial.time):
            return []
        self._current = command
        if side in self._started:
            self._started.clear()
        if not self._started:
            self._judged = 0
        self._started.add(side)
        self._running[side] = trial
        return self._judge_new()

    def add(self, side: str, stream: str, names: Sequence[str], stamp: int, values: Array) -> list[Judged]:
        """One measurement: `values` of the signals `names` at `stamp` (ns), NaN where not measured.

        Infinite values, or values beyond LARGEST, count as not measured.
        """
        values = np.where(np.abs(values) <= LARGEST, values, np.nan)
        known = self._streams[side].setdefault(stream, Stream(tuple(names)))
        if known.names != tuple(names):  # another publisher, or a model with other joints
            known.names = tuple(names)
            known.recent.clear()
        before = known.recent[-1] if known.recent else None
        if not known.add(stamp, values):
            return []
        judged = self._begin_early()
        if side in self._running:
            trial = self._running[side]
            trial.add(known.names, before, (stamp, values))
            judged += self._judge_new()
            if trial.ended and trial.ready() >= len(trial.grid):
                self.finish(side)
        return judged

    def end(self, side: str, mark: TrialMark) -> None:
        """A trial was played to its end; it counts once its last samples have come."""
        if side in self._early:
            self._early[side].append(mark)
        trial = self._running.get(side)
        if trial is not None and mark.trial == trial.mark.trial and mark.sequence_hash == trial.mark.sequence_hash:
            trial.ended = True
            if trial.ready() >= len(trial.grid):
                self.finish(side)

    def abort(self, side: str) -> None:
        """The running trial was aborted and does not count."""
        self._early.pop(side, None)
        if self._running.pop(side, None) is not None and self._current is not None:
            self._judge_all(self._current)

    def jumped(self, side: str) -> None:
        """The clock of a side jumped: its current trial has no consistent time and is left out; new samples are
        accepted."""
        for stream in self._streams[side].values():
            stream.recent.clear()
        self.abort(side)

    def forget(self, side: str) -> None:
        """Drops every trial of a side that has changed, for example a simulation whose model was replaced."""
        self._running.pop(side, None)
        self._early.pop(side, None)
        self._started.discard(side)
        for command in self._commands.values():
            command.finished[side].clear()
            command.itself = () if side == REAL else command.itself
            self._judge_all(command)

    def finish(self, side: str) -> None:
        """Closes a trial that has ended, whether or not all of its samples came. Does nothing to one still running."""
        trial = self._running.get(side)
        if trial is None or not trial.ended:
            return
        del self._running[side]
        command = self._commands[trial.mark.sequence_hash]
        command.finished[side].append(trial.values)
        self._judge_all(command)
        if side == REAL:
            command.itself = self._against_itself(command)

    def figures(self) -> Figures | None:
        """The shares of the command last played; None before the first sample was judged."""
        command = self._current
        if command is None or not command.seen.any():
            return None
        each = [
            Alikeness(command.time, command.signals, k, self._k_sim, command.alike[i], command.seen)
            for i, k in enumerate(self._ks)
        ]
        m, n = len(command.signals), len(self._ks)
        rig = command.itself
        return Figures(
            command=command.name,
            signals=command.signals,
            ks=self._ks,
            shares=np.array([[a.shares[name] for a in each] for name in command.signals]),
            joint=np.array([a.joint for a in each]),
            samples=int(command.seen.any(axis=1).sum()),
            trials=len(command.finished[REAL]) + (REAL in self._running),
            complete=not self._running,
            itself=np.array([[a.shares[s] for a in rig] for s in command.signals]) if rig else np.full((m, n), np.nan),
            itself_joint=np.array([a.joint for a in rig]) if rig else np.full(n, np.nan),
        )

    def _reference(self, mark: TrialMark, time: Array, signals: Sequence[str]) -> list[Array]:
        """(T, m) of each reference trial of a command."""
        if mark.sequence_hash not in self._references:
            return []
        trials = self._references[mark.sequence_hash].select(signals)
        values = np.full((trials.count, len(time), len(signals)), np.nan)
        shared = min(len(time), len(trials.time))
        values[:, :shared] = trials.values[:, :shared]
        return list(values)

    def _begin_early(self) -> list[Judged]:
        """Begins the trials whose marks came too early, once the samples around their start are there."""
        judged = []
        for side, (mark, *ends) in list(self._early.items()):
            streams = [stream for stream in self._streams[side].values() if stream.recent]
            around = any(stream.recent[0][0] <= mark.stamp <= stream.newest for stream in streams)
            if around and self._signals_of(side, mark):
                judged += self.start(side, mark)
                for end in ends:
                    self.end(side, end)
        return judged

    def _signals_of(self, side: str, mark: TrialMark) -> tuple[str, ...]:
        """What is compared in a trial; empty until something was measured."""
        if not any(stream.recent for stream in self._streams[side].values()):
            return ()
        command = self._commands.get(mark.sequence_hash)
        return self._common_signals(mark.sequence_hash) if command is None else command.signals

    def _common_signals(self, sequence_hash: str) -> tuple[str, ...]:
        def measured(side: str) -> list[str]:
            return [
                name
                for stream in self._streams[side].values()
                for column, name in enumerate(stream.names)
                if stream.recent and not np.isnan(stream.recent[-1][1][column])
            ]

        sim, reference = measured(SIM), self._references.get(sequence_hash)
        real = measured(REAL) if reference is None else reference.signals
        common = tuple(name for name in real if name in sim)
        return tuple(name for name in self._signals if name in common) if self._signals else common

    def _tunnel(self, command: _Command, side: str, rows: slice) -> Tunnel | None:
        """Of all trials of a side at these rows; the smoothing looks beyond them."""
        wide = slice(max(0, rows.start - HALF_WIDTH), min(len(command.time), rows.stop + HALF_WIDTH))
        values = [trial[wide] for trial in command.finished[side]]
        running = self._running.get(side)
        if running is not None and self._commands[running.mark.sequence_hash] is command:
            values.append(running.values[wide])
        if not values:
            return None
        tunnel = build_tunnel(self._trials(command, values, wide))
        tunnel = smooth(tunnel) if self._smoothed else tunnel
        inner = slice(rows.start - wide.start, rows.stop - wide.start)
        return replace(
            tunnel, time=tunnel.time[inner], mean=tunnel.mean[inner], lower=tunnel.lower[inner],
            upper=tunnel.upper[inner], seen=tunnel.seen[inner],
        )  # fmt: skip

    def _trials(self, command: _Command, values: Sequence[Array], rows: slice) -> Trials:
        units = tuple(self._units.get(name, "rad") for name in command.signals)
        none = np.empty((len(values), rows.stop - rows.start, 0))
        return Trials(command.time[rows], command.signals, units, np.stack(values), (), none)

    def _against_itself(self, command: _Command) -> tuple[AgainstItself, ...]:
        """Of the real trials that have ended, those of the reference included."""
        finished = command.finished[REAL]
        if not finished:
            return ()
        trials = self._trials(command, finished, slice(0, len(command.time)))
        return rig_against_itself(trials, self._ks, self._smoothed)

    def _judge_new(self) -> list[Judged]:
        """Judges the samples of the running trials that both sides have reached."""
        command = self._current
        if command is None or not self._running:
            return []
        ready = min(trial.ready() for trial in self._running.values())
        stamp = max(trial.mark.stamp for trial in self._running.values())
        for side in {REAL, SIM} - self._started:
            # A side that measures will start this trial, too; one that is silent does not take part.
            if any(stream.newest > stamp - SECOND for stream in self._streams[side].values()):
                return []
        if ready <= self._judged:
            return []
        rows = slice(self._judged, ready)
        self._judged = ready
        return self._judge(command, rows)

    def _judge(self, command: _Command, rows: slice) -> list[Judged]:
        real, sim = self._tunnel(command, REAL, rows), self._tunnel(command, SIM, rows)
        if real is None or sim is None:
            return []
        for i, k in enumerate(self._ks):
            result = alikeness(real, sim, k, self._k_sim)
            command.alike[i, rows], command.seen[rows] = result.alike, result.seen
        running = self._running.get(SIM) or self._running.get(REAL)
        stamp = int(running.grid[rows.stop - 1]) if running is not None else 0
        alike = command.alike[self._ks.index(1.0), rows] if 1.0 in self._ks else alikeness(real, sim).alike
        return [Judged(real, sim.mean, alike.copy(), stamp)]

    def _judge_all(self, command: _Command) -> None:
        """Judges the finished trials again; the samples of a running trial are included as far as they came."""
        command.seen[:] = False
        command.alike[:] = False
        self._judge(command, slice(0, len(command.time)))
