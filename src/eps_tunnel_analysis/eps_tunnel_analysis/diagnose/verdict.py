# SPDX-License-Identifier: Apache-2.0
"""The verdict: what is missing, how sure that is, and what to do next."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from math import exp
from typing import Any, Literal

from eps_tunnel_analysis.alikeness import Span
from eps_tunnel_analysis.diagnose.rank import (
    IMITATED,
    NAMELESS,
    NONE,
    OVERLOOKED,
    UNAIDED,
    UNEXPLAINED,
    UNKNOWN,
    Ranked,
    itself,
    name_of,
    ordered,
    smallest_set,
)
from eps_tunnel_analysis.diagnose.settings import SETTINGS
from eps_tunnel_analysis.outputs import plain, shown_number
from labyrinth_sim.registry import Registry
from labyrinth_sim.shown import shown

Kind = Literal["complete", "effect", "undecided", "unknown"]
NAMES = ("Coulomb", "LuGre", "Stribeck")  # in titles, that keep their capitals


@dataclass(frozen=True)
class Errors:
    """One model against the recordings, at the rig's own step.

    Attributes:
        error: mean over the positions of equation 10, rad (m for the ball).
        held_out: mean absolute error, in the same unit, on what was not fitted: recordings held out, or else stretches
            of time left out in turn.
        alikeness: joint, at k = 1.
    """

    error: float
    held_out: float
    alikeness: float


@dataclass(frozen=True)
class PlayError:
    """One recording: its name, whether it was held out of the fit, and the error of one model on it (rad)."""

    name: str
    held_out: bool
    error: float


@shown
@dataclass(frozen=True)
class AxisVerdict:
    """One axis.

    Attributes:
        marginals: effect -> probability that it is missing, and not something that behaves like it, whatever else is.
        none, unknown: probability that nothing is missing, and that something is that no set explains that was tried.
        explained: hypothesis -> share of the misfit beyond the noise that it takes away, with a 90 % interval.
        remaining: signal -> mean square left by what is named, in units of the noise floor: 1 is noise.
        floors: the same over all signals, before and after what is named.
        not_converged: hypotheses whose fit did not come to rest, or is worse than one that it contains.
        ranking: of all hypotheses.
    """

    marginals: Mapping[str, float]
    none: float
    unknown: float
    explained: Mapping[str, tuple[float, float, float]]
    remaining: Mapping[str, float]
    floors: tuple[float, float]
    not_converged: tuple[str, ...]
    ranking: tuple[Ranked, ...]


@shown
@dataclass(frozen=True)
class Verdict:
    """The result of a diagnosis.

    Attributes:
        verdict: "complete", "effect", "undecided" or "unknown".
        effects: what is named: candidate names as `backlash.x`, on the axis that lacks most first; the most probable
            ones where undecided.
        set: hypotheses with their probabilities, "none", "unknown", "overlooked" and "imitated" among them; they sum
            to 1.
        stated: the smallest part of `set` that holds the truth, or what behaves like it, with probability `coverage`.
        sentence: the verdict in plain words.
        where: time spent outside the tunnels by the model with refitted values, before anything is added.
        given, before, after: errors of the model as given, with its values refitted, and with the effects added.
        ball: the same three of the ball, where it was seen.
        plays: the same three for each recording.
        rig_against_itself: alikeness of one trial in the tunnel of the others, mean over the trials; NaN for only one.
        axes: the verdict on each axis by itself.
        values: the fitted parameters of the effects and the base.
        next_experiment: name of the sequence to play next, None where there is nothing to decide.
        notes: what could not be known, one sentence each.
    """

    verdict: Kind
    effects: tuple[str, ...]
    set: Mapping[str, float]
    stated: tuple[str, ...]
    coverage: float
    sentence: str
    where: tuple[Span, ...]
    given: Errors
    before: Errors
    after: Errors
    axes: Mapping[str, AxisVerdict]
    values: Mapping[str, float]
    seed: int
    evaluations: int
    seconds: float
    next_experiment: str | None = None
    notes: tuple[str, ...] = field(default=())
    ball: tuple[Errors, ...] = ()
    plays: tuple[tuple[PlayError, ...], ...] = ((), (), ())
    rig_against_itself: float = float("nan")

    @property
    def ranking(self) -> dict[str, tuple[Ranked, ...]]:
        """By axis."""
        return {axis: verdict.ranking for axis, verdict in self.axes.items()}

    @property
    def floor(self) -> dict[str, tuple[float, float]]:
        """Mean square of each axis's residuals in units of the noise floor, before and after."""
        return {axis: verdict.floors for axis, verdict in self.axes.items()}

    def to_json(self) -> dict[str, Any]:
        """Plain dicts, lists, numbers and words; NaN becomes None."""
        content = {
            "verdict": self.verdict,
            "effects": list(self.effects),
            "set": dict(self.set),
            "stated_set": list(self.stated),
            "coverage": self.coverage,
            "sentence": self.sentence,
            "axes": {axis: _axis_json(verdict) for axis, verdict in self.axes.items()},
            "where": [asdict(span) for span in self.where],
            "error_as_given": self.given.error,
            "error_before": self.before.error,
            "error_after": self.after.error,
            "held_out_as_given": self.given.held_out,
            "held_out_before": self.before.held_out,
            "held_out_after": self.after.held_out,
            "alikeness_as_given": self.given.alikeness,
            "alikeness_before": self.before.alikeness,
            "alikeness_after": self.after.alikeness,
            "rig_against_itself": self.rig_against_itself,
            **{k: [asdict(e) for e in e3] for k, e3 in zip(("given", "refitted", "after"), self.plays, strict=True)},
            **{f"ball_{w}": asdict(e) for w, e in zip(("as_given", "before", "after"), self.ball, strict=False)},
            "misfit_over_floor": {axis: list(pair) for axis, pair in self.floor.items()},
            "ranking": {axis: [{"name": r.name, **asdict(r)} for r in ranked] for axis, ranked in self.ranking.items()},
            "values": dict(self.values),
            "proposed_effect": None,
            "next_experiment": self.next_experiment,
            "notes": list(self.notes),
            "seed": self.seed,
            "evaluations": self.evaluations,
            "seconds": self.seconds,
        }
        result: dict[str, Any] = plain(content)
        return result


def _axis_json(verdict: AxisVerdict) -> dict[str, Any]:
    return {
        "marginals": {**verdict.marginals, NONE: verdict.none, UNKNOWN: verdict.unknown},
        "explained": {name: {"share": s, "interval": [a, b]} for name, (s, a, b) in verdict.explained.items()},
        "remaining": dict(verdict.remaining),
        "floors": list(verdict.floors),
        "not_converged": list(verdict.not_converged),
    }


def decide(probabilities: Mapping[str, float], coverage: float) -> tuple[Kind, tuple[str, ...], tuple[str, ...]]:
    """The verdict from these probabilities, the effects named, and the stated set.

    It is "unknown" if that is likelier than all sets of effects together, which may only share what is likely.
    """
    stated = smallest_set(probabilities, coverage)
    unknown = sum(probabilities.get(name, 0.0) for name in UNEXPLAINED)
    known = sum(p for name, p in probabilities.items() if name not in NAMELESS)
    if unknown >= max(known, probabilities.get(NONE, 0.0)):
        return "unknown", (), stated
    first = next(name for name in ordered(probabilities) if name not in UNEXPLAINED)
    named = tuple(first.split(" + ")) if first != NONE else ()
    if len(stated) > 1:
        return "undecided", named, stated
    return ("complete" if first == NONE else "effect"), named, stated


def sentence(
    kind: Kind,
    effects: Sequence[str],
    stated: Sequence[str],
    probabilities: Mapping[str, float],
    axes: Mapping[str, AxisVerdict],
    registry: Registry,
    floor: bool = True,
) -> str:
    """The verdict in plain words, axis by axis where the recordings do not decide as a whole.

    Args:
        floor: whether trials were repeated.
    """
    if kind == "complete" and not floor:
        return (
            f"No effect of the library explains more ({percent(probabilities[NONE])}); one trial cannot show whether "
            "what is left is noise."
        )
    if kind == "complete":
        # More than this is left only beside effects that were added before, as an error of their forms.
        most = SETTINGS.healthy * exp(UNAIDED)
        left = [f"{shown_number(v.floors[0])} floors on {axis}" for axis, v in axes.items() if v.floors[0] > most]
        if left:
            return (
                f"Nothing more is named ({percent(probabilities[NONE])}): what is left, {' and '.join(left)}, may be "
                "an error of the form of what was added before."
            )
        return f"Nothing is missing within the noise ({percent(probabilities[NONE])})."
    if kind == "effect":
        sure = percent(probabilities[stated[0]])
        lacks = f"The model lacks {' and '.join(in_words(name, registry) for name in effects)} ({sure})"
        them = "it" if len(effects) == 1 else "them"
        return f"{lacks}{_imitated(f', or something that behaves like {them}', probabilities)}."
    if kind == "unknown":
        start = f"Something is missing that no known effect explains in full ({percent(probabilities[UNKNOWN])})"
        if OVERLOOKED in probabilities:
            start += f", or a combination of known effects that was not found ({percent(probabilities[OVERLOOKED])})"
        start += "."
    else:
        start = undecided([f"{_hypothesis(name, registry)} ({percent(probabilities[name])})" for name in stated])
        start = f"{start[:-1]}{_imitated('; something else may behave like them', probabilities)}."
    return " ".join([start, *(text for axis, verdict in axes.items() if (text := _part(axis, verdict, registry)))])


def _part(axis: str, verdict: AxisVerdict, registry: Registry) -> str:
    """What is clear about one axis by itself; empty if nothing is."""
    before, _ = verdict.floors
    clear = [name for name, p in verdict.marginals.items() if p >= itself(SETTINGS.clear)]
    if clear:
        named = " and ".join(f"{in_words(name, registry)} ({percent(verdict.marginals[name])})" for name in clear)
        start, alone = f"{named[0].upper()}{named[1:]}", verdict.explained.get(name_of(clear))
        if alone:
            explain = "explains" if len(clear) == 1 else "explain"
            return f"{start} {explain} {percent(alone[0])} of what the model leaves there."
        shares = (share for name, (share, _, _) in verdict.explained.items() if set(clear) <= set(name.split(" + ")))
        part = "is part" if len(clear) == 1 else "are part"
        return f"{start} {part} of every likely set; the best explains {percent(max(shares, default=0.0))}."
    most = max(verdict.explained.items(), key=lambda item: item[1][0], default=None)
    if verdict.none < 0.5 and most and most[1][0] >= SETTINGS.worth_stating:
        share = percent(most[1][0])
        return f"On {axis} {_hypothesis(most[0], registry)} explains {share} of {shown_number(before)} floors."
    if verdict.none >= SETTINGS.clear:
        return f"Nothing is missing on {axis}, {shown_number(before, 2)} floors."
    return f"On {axis} {shown_number(before)} floors remain."


def _imitated(words: str, probabilities: Mapping[str, float]) -> str:
    return f"{words} ({percent(probabilities[IMITATED])})" if IMITATED in probabilities else ""


def undecided(options: Sequence[str]) -> str:
    """Two or more options, in words."""
    return f"These recordings do not decide between {', '.join(options[:-1])} and {options[-1]}."


def percent(probability: float) -> str:
    """As a whole number, never 100 %."""
    return "over 99%" if probability > 0.99 else f"{probability:.0%}"


def in_words(name: str, registry: Registry) -> str:
    """A candidate in words: "backlash on x"."""
    effect, _, place = name.partition(".")
    title = registry.effects[effect].title if effect in registry.effects else effect
    words = title if title.startswith(NAMES) else f"{title[0].lower()}{title[1:]}"
    return f"{words} on {'the ball' if place == 'ball' else place}"


def _hypothesis(name: str, registry: Registry) -> str:
    if name == NONE:
        return "nothing missing"
    if name == UNKNOWN:
        return "something unknown"
    if name == OVERLOOKED:
        return "known effects that were not found"
    return " with ".join(in_words(part, registry) for part in name.split(" + "))
