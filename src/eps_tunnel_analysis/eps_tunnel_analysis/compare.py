# SPDX-License-Identifier: Apache-2.0
"""The one function that compares real and simulated trajectories."""

import math
from collections.abc import Iterable
from dataclasses import asdict, dataclass, replace
from itertools import zip_longest
from typing import Any

import numpy as np

from eps_tunnel_analysis.alikeness import (
    KS,
    LEAST_TRIALS,
    AgainstItself,
    Alikeness,
    Span,
    alikeness_over_k,
    rig_against_itself,
)
from eps_tunnel_analysis.error import SignalError, mean_error, signal_errors
from eps_tunnel_analysis.outputs import plain
from eps_tunnel_analysis.phases import Misfit, sentences, where
from eps_tunnel_analysis.tunnel import Tunnel, build_tunnel, smooth
from labyrinth_sim.errors import InputError, unknown_name
from labyrinth_sim.shown import shown
from labyrinth_sim.trials import Trials

TRIM = 0.5  # s by which one side may be longer; the rest of it is left out, with a note


JOINTLY = "jointly"


@dataclass(frozen=True)
class Curve:
    """Alikeness over the n factors k.

    Attributes:
        name: of a signal, or JOINTLY.
        shares: n shares of alike samples; NaN where no sample was seen.
        itself: n shares that the rig reaches against itself; empty with too few trials.
    """

    name: str
    shares: tuple[float, ...]
    itself: tuple[float, ...]


@shown
@dataclass(frozen=True)
class Comparison:
    """How far a simulation is from reality, and where.

    Attributes:
        real, sim: the trials compared: same signals, same time.
        real_tunnel, sim_tunnel: of these trials, smoothed (equation 12) or not.
        alikeness: one for each real factor k, in rising order of k.
        against_itself: what the rig reaches against itself at the same factors; empty with too few trials.
        errors: one per signal.
        where: the misfit over phases, directions, amplitudes, axes and trials.
        notes: what was left out on the way, in words.
    """

    real: Trials
    sim: Trials
    real_tunnel: Tunnel
    sim_tunnel: Tunnel
    alikeness: tuple[Alikeness, ...]
    errors: tuple[SignalError, ...]
    where: tuple[Misfit, ...]
    notes: tuple[str, ...] = ()
    against_itself: tuple[AgainstItself, ...] = ()

    @property
    def signals(self) -> tuple[str, ...]:
        """m names."""
        return self.real.signals

    @property
    def curves(self) -> tuple[Curve, ...]:
        """One for each signal, and one for all jointly where there are several."""
        made = [
            Curve(n, tuple(a.shares[n] for a in self.alikeness), tuple(a.shares[n] for a in self.against_itself))
            for n in self.signals
        ]
        joint = Curve(JOINTLY, tuple(a.joint for a in self.alikeness), tuple(a.joint for a in self.against_itself))
        return (*made, *([joint] if len(made) > 1 else []))

    @property
    def mean_error(self) -> float:
        """Equation 10, mean over the signals in rad, or those in m where none turns."""
        return mean_error([e.command_error for e in self.errors], self.real.units)

    @property
    def most_off(self) -> int:
        """Index of the signal that is most off: in units of its repeat spread, of its range where that is not known."""
        off = [e.rms / e.repeat_rms if e.repeat_rms > 0 else e.rms / (e.range or math.inf) for e in self.errors]
        return int(np.argmax(np.nan_to_num(off)))

    @property
    def spans(self) -> tuple[Span, ...]:
        """Runs of time outside the tunnel at the smallest k, signal by signal."""
        return tuple(span for name in self.signals for span in self.alikeness[0].spans(name))

    def to_json(self) -> dict[str, Any]:
        """Plain dicts, lists, numbers and words; NaN becomes None. SI units."""
        content = {
            "signals": list(self.signals),
            "units": list(self.real.units),
            "samples": len(self.real.time),
            "step": self.real.step,
            "trials_real": self.real.count,
            "trials_sim": self.sim.count,
            "smoothed": self.real_tunnel.smoothed,
            "k_sim": self.alikeness[0].k_sim,
            "alikeness": [
                {
                    "k": a.k_real,
                    "joint": a.joint,
                    "signals": a.shares,
                    "unseen": a.unseen,
                    "unseen_joint": a.joint_unseen,
                    "rig_against_itself": {"joint": rig.joint, "signals": dict(rig.shares)} if rig else None,
                }
                for a, rig in zip_longest(self.alikeness, self.against_itself)
            ],
            "errors": [asdict(e) for e in self.errors],
            "spans": [asdict(s) for s in self.spans],
            "where": [asdict(m) for m in self.where],
            "where_in_words": list(sentences(self.where)),
            "notes": list(self.notes),
        }
        return {key: plain(value) for key, value in content.items()}


def compare(
    real: Trials,
    sim: Trials,
    ks: Iterable[float] = KS,
    smoothed: bool = True,
    k_sim: float = 1.0,
    signals: Iterable[str] | None = None,
) -> Comparison:
    """Tunnels, alikeness for each k, errors, and where the simulation fails.

    Args:
        real, sim: trials of the same sequence on even grids with the same step and start. A side that is up to
            TRIM longer is cut to the other's length.
        ks: factors of the real tunnel; k_sim is the factor of the simulated one.
        smoothed: filter the limits by equation 12, as the paper does before counting.
        signals: which to compare; by default all that both sides have.

    Raises:
        InputError: no signal in common, an unknown signal, other units, another time grid, an invalid k.
    """
    factors = tuple(sorted({float(k) for k in ks}))
    if not factors:
        raise InputError("At least one factor k is needed, for example 1.")
    names, notes = _signals(real, sim, signals)
    real, sim = real.select(names), sim.select(names)
    if real.units != sim.units:
        rows = [f"{n} ({a}, {b})" for n, a, b in zip(names, real.units, sim.units, strict=True) if a != b]
        raise InputError(f"Signals whose units differ between real and simulation: {', '.join(rows)}.")
    real, sim, cut = _same_time(real, sim)
    real_tunnel, sim_tunnel = build_tunnel(real), build_tunnel(sim)
    if smoothed:
        real_tunnel, sim_tunnel = smooth(real_tunnel), smooth(sim_tunnel)
    if real.count == 1:
        notes += ("Only one real trial: its tunnel has no width, so the rig's repeatability is not known.",)
    elif real.count < LEAST_TRIALS:
        notes += ("Only two real trials: the rig's alikeness to itself needs three trials; five are better.",)
    return Comparison(
        real=real,
        sim=sim,
        real_tunnel=real_tunnel,
        sim_tunnel=sim_tunnel,
        alikeness=alikeness_over_k(real_tunnel, sim_tunnel, factors, k_sim),
        errors=signal_errors(real, sim),
        where=where(real, sim),
        notes=notes + cut,
        against_itself=rig_against_itself(real, factors, smoothed),
    )


def _signals(real: Trials, sim: Trials, asked: Iterable[str] | None) -> tuple[tuple[str, ...], tuple[str, ...]]:
    common = tuple(s for s in real.signals if s in sim.signals)
    if asked is not None:
        names = tuple(dict.fromkeys(asked))
        unknown = [unknown_name("signal", name, common) for name in names if name not in common]
        if unknown:
            raise InputError(unknown)
        return names, ()
    if not common:
        raise InputError(
            f"The two sides have no signal in common. Real: {', '.join(real.signals)}; "
            f"simulation: {', '.join(sim.signals)}."
        )
    one_sided = [f"{s} (real only)" for s in real.signals if s not in common]
    one_sided += [f"{s} (simulation only)" for s in sim.signals if s not in common]
    return common, (f"Signals on one side only, left out: {', '.join(one_sided)}.",) if one_sided else ()


def _same_time(real: Trials, sim: Trials) -> tuple[Trials, Trials, tuple[str, ...]]:
    """Both sides cut to the time they share."""
    t = min(len(real.time), len(sim.time))
    longest = max(real.time[-1], sim.time[-1])
    if not math.isclose(real.step, sim.step, rel_tol=1e-6) and t > 1:
        raise InputError(
            f"The two sides need one sampling step; real has {real.step:g} s, simulation {sim.step:g} s. "
            "Resample both at the same rate."
        )
    if not np.allclose(real.time[:t], sim.time[:t], rtol=0, atol=1e-6):
        raise InputError(f"The two sides start at different times: {real.time[0]:g} s and {sim.time[0]:g} s.")
    missing = float(longest - real.time[t - 1])
    if missing > TRIM + 1e-9:
        raise InputError(
            f"The two sides differ in length: real ends at {real.time[-1]:g} s, simulation at {sim.time[-1]:g} s. "
            "Are they of the same sequence?"
        )
    note = (f"The last {missing:.2f} s, which one side lacks, are left out.",) if missing > 0 else ()
    return _first(real, t), _first(sim, t), note


def _first(trials: Trials, t: int) -> Trials:
    if len(trials.time) == t:
        return trials
    return replace(trials, time=trials.time[:t], values=trials.values[:, :t], commands=trials.commands[:, :t])
