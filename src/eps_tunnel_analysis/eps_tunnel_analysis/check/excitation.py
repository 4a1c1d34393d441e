# SPDX-License-Identifier: Apache-2.0
"""What recorded commands excite: which values and which effects they can identify, from one batch of roll-outs.

An effect is tried at its typical strength. The change that it causes, in units of the noise floor, minus the part that
the free values can absorb (in the span of their slopes), is what is seen of it. Minus what another effect can absorb,
it is what distinguishes it from that one.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from eps_tunnel_analysis.diagnose.axis_search import AxisPart, axis_parts
from eps_tunnel_analysis.diagnose.ball import without_ball
from eps_tunnel_analysis.diagnose.candidates import Candidate, library
from eps_tunnel_analysis.diagnose.evidence import Evidence, play_evidence
from eps_tunnel_analysis.diagnose.settings import SETTINGS
from eps_tunnel_analysis.fit.differences import steps_within
from eps_tunnel_analysis.recorded_play import Play
from labyrinth_sim.model import Model, ParameterInfo
from labyrinth_sim.trials import Array

Answer = Literal["identifiable", "weak", "no"]

LONGEST_STEP = 0.005  # s, at most, between the steps of the roll-outs
MOST_SECONDS = 60.0  # of plays that are rolled out; the first in any case
SLOPE = 0.05  # share of a value by which it is moved; the bounds of a search may be a thousand times as wide
DELAY_SHARE = 0.6  # share of a delay's bounds by which it is moved: as far as a typical delay of commands
VISIBLE = 3.0  # floors, of an effect that is seen without doubt
PRECISE, WEAK = 0.2, 1.0  # 95 % interval over the value itself, up to which it is identifiable, weak
LEAST_SIZE = 0.05  # share of its span that a value near 0 is weighed against
INSEPARABLE = 0.97  # correlation of two values' errors from which they cannot be separated
SAME_EFFECT = 0.999  # share of two values' effects in common, from which they are one: a mass and an armature


@dataclass(frozen=True)
class Excited:
    """The result for one value or effect.

    Attributes:
        name: full parameter name, or effect.place.
        axis: its axis.
        kind: "value" or "effect".
        answer: identifiable, weak or no.
        figure: of a value the 95 % half-width to expect, in its unit; of an effect the mean square in floors that the
            values cannot absorb.
        unit: of the figure; "floors" for an effect.
        confounded: what it cannot be distinguished from by these commands.
        mend: what to play, "" where nothing needs to be improved.
    """

    name: str
    axis: str
    kind: Literal["value", "effect"]
    answer: Answer
    figure: float
    unit: str
    confounded: tuple[str, ...]
    mend: str


def excitation(
    model: Model,
    plays: Sequence[Play],
    only: Sequence[str] | None = None,
    nthread: int = 0,
    progress: Callable[[str, int], None] | None = None,
) -> tuple[Excited, ...]:
    """What the plays' commands can identify of each free value and of each effect that the model does not have.

    Args:
        only: names of effects to try; all by default.
        progress: called with the number of roll-outs made.
    """
    chosen = _some([without_ball(play) for play in plays])
    parts = axis_parts(model, chosen)
    if not parts:
        return ()
    base = tuple(name for part in parts for name in part.base)
    lib = library(model, base, only=only)
    signals = tuple(dict.fromkeys(name for part in parts for name in part.signals))
    names = lib.names
    evidence = Evidence(
        lib.model, names, [play_evidence(lib.model, p, signals) for p in chosen], signals, LONGEST_STEP, nthread
    )
    infos = lib.model.parameters()
    # A sledge in an MJCF may have no armature, which is less than a fit may try.
    start = np.array([np.clip(infos[name].value, infos[name].low, infos[name].high) for name in names])
    rows = [start, *(_moved(start, i, infos[name]) for i, name in enumerate(base))]
    rows += [_switched_on(start, names, candidate, lib.model) for candidate in lib.candidates]
    if progress:
        progress("check", len(rows) * len(chosen))
    seen = evidence(np.array(rows))
    changes = np.nan_to_num((seen[1:] - seen[0]) / evidence.floor)
    slopes, strengths = changes[: len(base)], changes[len(base) :]
    excited = list(_values(base, slopes, infos, parts, model, chosen))
    return (*excited, *_effects(lib.candidates, strengths, slopes, evidence, parts))


def _some(plays: Sequence[Play]) -> list[Play]:
    """Plays up to a total length, at least the first."""
    kept: list[Play] = []
    for play in plays:
        if kept and sum(p.trials.time[-1] for p in (*kept, play)) > MOST_SECONDS:
            break
        kept.append(play)
    return kept


def _moved(start: Array, index: int, info: ParameterInfo) -> Array:
    row = start.copy()
    row[index] += steps_within(row[index], _step(info), info.low, info.high)
    return row


def _step(info: ParameterInfo) -> float:
    """By how much a value is varied, in its unit; a delay by a delay that is typical of a missing effect."""
    if info.unit == "s":
        return DELAY_SHARE * info.span
    return SLOPE * (abs(info.value) or LEAST_SIZE * info.span)


def _switched_on(start: Array, names: Sequence[str], candidate: Candidate, model: Model) -> Array:
    row = start.copy()
    for parameter, p in zip(candidate.parameters, candidate.effect.parameters, strict=True):
        row[names.index(parameter)] = p.sized(model.size(candidate.place)).typical
    return row


def _values(
    base: Sequence[str], slopes: Array, infos: dict[str, ParameterInfo], parts: Sequence[AxisPart], model: Model,
    plays: Sequence[Play],
) -> list[Excited]:  # fmt: skip
    excited = []
    for part in parts:
        own = [i for i, name in enumerate(base) if name in part.base]
        if not own:
            continue
        spans = [infos[base[i]].span for i in own]
        steps = np.array([_step(infos[base[i]]) / span for i, span in zip(own, spans, strict=True)])
        columns = slopes[own].T / steps  # floors per span
        information = columns.T @ columns / SETTINGS.correlated
        size = np.sqrt(np.maximum(np.diag(information), 1e-300))
        # Scaled, so that the inverse minds no units; a ridge keeps what nothing moves finite.
        scaled = information / np.outer(size, size) + 1e-12 * np.eye(len(own))
        inverse = np.linalg.inv(scaled)
        deviation = np.sqrt(np.maximum(np.diag(inverse), 0.0)) / size
        correlation = inverse / np.sqrt(np.outer(np.diag(inverse), np.diag(inverse)))
        for k, i in enumerate(own):
            info = infos[base[i]]
            half = min(2.0 * float(deviation[k]), 1.0) * info.span
            share = half / max(abs(info.value), LEAST_SIZE * info.span)
            answer: Answer = "identifiable" if share <= PRECISE else "weak" if share <= WEAK else "no"
            others = [j for j in range(len(own)) if j != k]
            same = [base[own[j]] for j in others if abs(scaled[k, j]) > SAME_EFFECT]
            answer = "weak" if same and answer == "identifiable" else answer
            alike = [base[own[j]] for j in others if abs(correlation[k, j]) > INSEPARABLE or base[own[j]] in same]
            alike = alike if answer != "identifiable" else []
            mend = "" if answer == "identifiable" else livelier(part.name, model, plays)
            excited.append(Excited(info.name, part.name, "value", answer, half, info.unit, tuple(alike), mend))
    return excited


def livelier(axis: str, model: Model, plays: Sequence[Play]) -> str:
    """What to add to a command so that it excites more of an axis."""
    own = model.rig.axis(axis)
    spans, starts, rests = [], [], []
    for play in plays:
        command = play.trials.commands[0, :, play.trials.command_channels.index(own.command)]
        sent = command[np.isfinite(command)]
        if len(sent) > 2:
            rates = np.abs(np.diff(sent))
            spans.append(float(np.ptp(sent)))
            starts.append(float(rates.max() / max(np.ptp(sent), 1e-12)))
            rests.append(float(np.mean(rates == 0.0)))
    if not spans:
        return "play a command that moves this axis, as config/sequences/excite_12s.yaml"
    missing = []
    share = max(spans) / (own.limits[1] - own.limits[0])
    if share < 0.3:
        missing.append(f"larger motions (now {share:.0%} of the axis's range)")
    if max(starts) < 0.2:
        missing.append("steps")
    if max(rests) < 0.05:
        missing.append("rests of half a second")
    if len(plays) < 2:
        missing.append("slow triangles in addition to fast sines")
    return f"play {', '.join(missing)}" if missing else "play faster reversals, and another load or start"


def _effects(
    candidates: Sequence[Candidate], strengths: Array, slopes: Array, evidence: Evidence, parts: Sequence[AxisPart]
) -> list[Excited]:
    excited: list[Excited] = []
    rank = np.linalg.svd(slopes.T, full_matrices=False) if len(slopes) else None
    if rank is not None:
        left, sizes, _ = rank
        kept = left[:, sizes > 1e-9 * max(float(sizes.max(initial=0.0)), 1e-300)]
        strengths = strengths - (strengths @ kept) @ kept.T
    power = np.sum(strengths**2, axis=1)
    for part in parts:
        own = [i for i, c in enumerate(candidates) if c.axes == (part.name,)]
        columns = [s for s, name in enumerate(evidence.signals) if name in part.signals]
        count = sum(len(play.noise[s].time) for play in evidence.plays for s in columns)
        for i in own:
            seen = float(power[i]) / max(count, 1)
            like = []
            for j in own:
                if j != i and power[j] > 0.0:
                    shared = float(strengths[i] @ strengths[j]) ** 2 / float(power[i] * power[j]) if power[i] else 1.0
                    if seen * (1.0 - shared) < SETTINGS.material:
                        like.append((shared, candidates[j].name))
            visible = seen >= SETTINGS.material
            confounded = (
                tuple(name for shared, name in sorted(like, reverse=True) if shared > 0.5)[:4] if visible else ()
            )
            answer: Answer = "no" if not visible else "weak" if confounded or seen < VISIBLE else "identifiable"
            mend = "" if answer == "identifiable" else candidates[i].effect.separated_by
            excited.append(Excited(candidates[i].name, part.name, "effect", answer, seen, "floors", confounded, mend))
    return excited
