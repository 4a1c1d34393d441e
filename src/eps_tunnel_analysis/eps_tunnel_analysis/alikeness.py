# SPDX-License-Identifier: Apache-2.0
"""Alikeness: the share of samples at which the tunnels of the real and the simulated system overlap; and how alike the
real system is to itself, for comparison."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from eps_tunnel_analysis.tunnel import Tunnel, build_tunnel, smooth
from labyrinth_sim.errors import InputError, unknown_name
from labyrinth_sim.shown import shown
from labyrinth_sim.trials import Array, Trials, runs

Mask = NDArray[np.bool_]
KS = (1.0, 2.0, 3.0, 4.0, 5.0)
LEAST_TRIALS = 3  # the others need a tunnel with a width when one is left out
MOST_LEFT_OUT = 20  # trials, evenly spread over all of them; more say the same and take long


@dataclass(frozen=True)
class Span:
    """A run of seen samples outside the tunnel.

    Attributes:
        signal: its name; "jointly" where it is about all signals together.
        start: s, time of the first sample outside.
        end: s, time of the last sample outside, plus one step.
        samples: how many.
    """

    signal: str
    start: float
    end: float
    samples: int


@shown
@dataclass(frozen=True)
class Alikeness:
    """Which of T samples of m signals are alike (equation 6), and the shares that follow (equation 7).

    The share is the paper's SRG: 1 is alike everywhere. Samples that one side never saw are left out of it.

    Attributes:
        time: (T,) s.
        signals: m names.
        k_real, k_sim: factors by which the tunnels were widened.
        alike: (T, m); False where unseen.
        seen: (T, m) whether both sides saw the sample.
    """

    time: Array
    signals: tuple[str, ...]
    k_real: float
    k_sim: float
    alike: Mask
    seen: Mask

    def __post_init__(self) -> None:
        for name in ("alike", "seen"):
            mask = np.array(getattr(self, name), dtype=np.bool_)
            if mask.shape != (len(self.time), len(self.signals)):
                raise InputError(f"{name} must be (T, m), got {mask.shape} for {len(self.time)} samples.")
            mask.setflags(write=False)
            object.__setattr__(self, name, mask)

    @property
    def shares(self) -> dict[str, float]:
        """Share of alike samples per signal, equation 7; NaN for a signal never seen."""
        return {name: _share(self.alike[:, i], self.seen[:, i]) for i, name in enumerate(self.signals)}

    @property
    def joint(self) -> float:
        """Share of samples alike in every signal (equation 4), of those seen in every signal."""
        return _share(np.all(self.alike, axis=1), np.all(self.seen, axis=1))

    @property
    def unseen(self) -> dict[str, int]:
        """Samples left out, per signal."""
        return {name: int(np.sum(~self.seen[:, i])) for i, name in enumerate(self.signals)}

    @property
    def joint_unseen(self) -> int:
        """Samples left out of the joint share."""
        return int(np.sum(~self.seen.all(axis=1)))

    def spans(self, signal: str | None = None) -> tuple[Span, ...]:
        """Runs of time outside, in order; of all signals together without a name."""
        if signal is None:
            outside = self.seen.all(axis=1) & ~self.alike.all(axis=1)
        elif signal in self.signals:
            i = self.signals.index(signal)
            outside = self.seen[:, i] & ~self.alike[:, i]
        else:
            raise InputError(unknown_name("signal", signal, self.signals))
        step = float(self.time[1] - self.time[0]) if len(self.time) > 1 else 0.0
        return tuple(
            Span(signal or "jointly", float(self.time[a]), float(self.time[b - 1]) + step, b - a)
            for a, b in runs(np.asarray(outside))
        )


def alikeness(real: Tunnel, sim: Tunnel, k_real: float = 1.0, k_sim: float = 1.0) -> Alikeness:
    """Where the two tunnels meet, equations 4 to 6; with a simulation of width zero this is equation 13.

    Raises:
        InputError: other signals, units or time on the two sides; a factor that is negative or not finite.
    """
    complaints = [
        f"{name} must be finite and at least 0, got {k}."
        for name, k in (("k_real", k_real), ("k_sim", k_sim))
        if not (math.isfinite(k) and k >= 0)
    ]
    complaints += _mismatches(real, sim)
    if complaints:
        raise InputError(complaints)
    seen = ~(np.isnan(real.mean) | np.isnan(sim.mean))
    apart = sim.mean - real.mean
    low, high = k_real * real.lower - k_sim * sim.upper, k_real * real.upper - k_sim * sim.lower
    # A mean of p values of magnitude M is rounded by at most (p - 1) ulp(M) / 2, and the few operations above add an
    # ulp each. For angles of a radian and ten trials this is 4e-15 rad: nothing that a sensor could resolve.
    ulps = real.trials + sim.trials + 4
    magnitude = _reach(real, k_real) + _reach(sim, k_sim)
    rounding = ulps * np.finfo(np.float64).eps * magnitude
    with np.errstate(invalid="ignore"):
        alike = seen & (low - rounding <= apart) & (apart <= high + rounding)
    return Alikeness(real.time, real.signals, float(k_real), float(k_sim), alike, seen)


def alikeness_over_k(real: Tunnel, sim: Tunnel, ks: Iterable[float] = KS, k_sim: float = 1.0) -> tuple[Alikeness, ...]:
    """The alikeness at each real factor k, as in the paper's tables 2 and 3."""
    return tuple(alikeness(real, sim, k, k_sim) for k in ks)


@dataclass(frozen=True)
class AgainstItself:
    """How alike the rig is to itself: one trial against the tunnel of the others, mean over the trials.

    The yardstick of an alikeness: a model that reaches it is as close to the rig as one more trial of the rig.

    Attributes:
        k_real: factor by which the tunnels of the others were widened.
        shares: signal -> share of samples inside, equation 7; NaN for a signal never seen.
        joint: share of samples inside in every signal; NaN where no sample was seen in all.
    """

    k_real: float
    shares: Mapping[str, float]
    joint: float


def rig_against_itself(trials: Trials, ks: Iterable[float] = KS, smoothed: bool = True) -> tuple[AgainstItself, ...]:
    """At each factor k how alike one trial is to the others; empty with fewer than LEAST_TRIALS.

    Args:
        trials: of the real system.
        smoothed: filter the limits by equation 12, as where the simulation is compared.
    """
    p = trials.count
    if p < LEAST_TRIALS:
        return ()
    factors, rows = tuple(ks), np.arange(p)
    judged = []
    for out in np.unique(np.linspace(0, p - 1, min(p, MOST_LEFT_OUT)).round().astype(int)):
        one, others = (build_tunnel(_some(trials, chosen)) for chosen in (rows == out, rows != out))
        judged.append(alikeness_over_k(smooth(others) if smoothed else others, one, factors))
    return tuple(
        AgainstItself(
            k_real=float(k),
            shares={name: _mean([a[i].shares[name] for a in judged]) for name in trials.signals},
            joint=_mean([a[i].joint for a in judged]),
        )
        for i, k in enumerate(factors)
    )


def joint_against_itself(several: Sequence[Trials], ks: Iterable[float] = KS) -> dict[float, float]:
    """k -> joint share that the rig reaches against itself over several commands, weighed by their samples.

    NaN where no command has enough trials.
    """
    factors = tuple(ks)
    seen, alike = 0.0, np.zeros(len(factors))
    for trials in several:
        itself = rig_against_itself(trials, factors)
        known: Mask = np.any(~np.isnan(trials.values), axis=0)  # (T, m)
        samples = float(np.all(known, axis=1).sum())
        if itself and samples:
            seen += samples
            alike += samples * np.array([at.joint for at in itself])
    return dict(zip(factors, (alike / seen if seen else alike + math.nan).tolist(), strict=True))


def _some(trials: Trials, chosen: Mask) -> Trials:
    return replace(trials, values=trials.values[chosen], commands=trials.commands[chosen])


def _mean(shares: Sequence[float]) -> float:
    """Of those that are known."""
    known = [share for share in shares if not math.isnan(share)]
    return math.fsum(known) / len(known) if known else math.nan


def _reach(tunnel: Tunnel, k: float) -> Array:
    """How large the numbers were from which a tunnel was computed and widened, (T, m)."""
    return np.abs(tunnel.mean) + (1 + k) * (tunnel.upper - tunnel.lower)


def _mismatches(real: Tunnel, sim: Tunnel) -> list[str]:
    complaints = []
    if real.signals != sim.signals:
        complaints.append(f"Both sides need the same signals; real has {real.signals}, simulation {sim.signals}.")
    elif real.units != sim.units:
        complaints.append(f"Both sides need the same units; real has {real.units}, simulation {sim.units}.")
    if len(real.time) != len(sim.time) or not np.allclose(real.time, sim.time, rtol=0, atol=1e-6):
        complaints.append(
            f"Both sides need the same time grid; real has {_grid(real.time)}, simulation {_grid(sim.time)}."
        )
    return complaints


def _grid(time: Array) -> str:
    return f"{len(time)} samples from {time[0]:g} to {time[-1]:g} s"


def _share(alike: Mask, seen: Mask) -> float:
    """Share of the seen samples (T,) that are alike."""
    count = int(seen.sum())
    return float(np.sum(alike & seen)) / count if count else math.nan
