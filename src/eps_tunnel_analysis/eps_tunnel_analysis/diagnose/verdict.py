# SPDX-License-Identifier: Apache-2.0
"""The verdict: what is missing, how sure that is, and what to do next."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

from eps_tunnel_analysis.alikeness import Span
from eps_tunnel_analysis.diagnose.rank import NONE, UNKNOWN, Ranked, smallest_set
from labyrinth_sim.effect import effects as library_effects

Kind = Literal["complete", "effect", "undecided", "unknown"]


@dataclass(frozen=True)
class Errors:
    """One model against the recordings, at the rig's own step.

    Attributes:
        error: mean over the positions of equation 10, rad (m for the ball).
        held_out: mean absolute error on the samples kept from the fit, in the same unit.
        alikeness: joint, at k = 1.
    """

    error: float
    held_out: float
    alikeness: float


@dataclass(frozen=True)
class Verdict:
    """What a diagnosis says.

    Attributes:
        verdict: "complete", "effect", "undecided" or "unknown".
        effects: what is named: candidate names as `backlash.x`, on the axis that lacks most first; the most probable
            ones where undecided.
        set: hypotheses with their probabilities, "none" and "unknown" among them; they sum to 1.
        stated: the smallest part of `set` that holds the truth with probability `coverage`.
        sentence: the verdict in plain words.
        where: time spent outside the tunnels by the model with refitted values, before anything is added.
        given, before, after: errors of the model as given, with its values refitted, and with the effects added.
        ball: the same three of the ball, where it was seen.
        floor: mean square of each axis's residuals in units of the noise floor, before and after.
        ranking: by axis.
        values: what the effects' and the base's parameters came out as.
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
    floor: Mapping[str, tuple[float, float]]
    ranking: Mapping[str, tuple[Ranked, ...]]
    values: Mapping[str, float]
    seed: int
    evaluations: int
    seconds: float
    next_experiment: str | None = None
    notes: tuple[str, ...] = field(default=())
    ball: tuple[Errors, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """Plain dicts, lists, numbers and words; NaN becomes None."""
        content = {
            "verdict": self.verdict,
            "effects": list(self.effects),
            "set": dict(self.set),
            "stated_set": list(self.stated),
            "coverage": self.coverage,
            "sentence": self.sentence,
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
            **{f"ball_{w}": asdict(e) for w, e in zip(("as_given", "before", "after"), self.ball, strict=False)},
            "misfit_over_floor": {axis: list(pair) for axis, pair in self.floor.items()},
            "ranking": {axis: [{"name": r.name, **asdict(r)} for r in ranked] for axis, ranked in self.ranking.items()},
            "values": dict(self.values),
            "next_experiment": self.next_experiment,
            "notes": list(self.notes),
            "seed": self.seed,
            "evaluations": self.evaluations,
            "seconds": self.seconds,
        }
        plain: dict[str, Any] = _plain(content)
        return plain


def decide(probabilities: Mapping[str, float], coverage: float) -> tuple[Kind, tuple[str, ...], tuple[str, ...]]:
    """What to say of these probabilities: the verdict, the effects named, and the stated set."""
    stated = smallest_set(probabilities, coverage)
    first = stated[0]
    named = tuple(first.split(" + ")) if first not in (NONE, UNKNOWN) else ()
    if first == UNKNOWN:
        return "unknown", (), stated
    if len(stated) > 1:
        return "undecided", named, stated
    return ("complete" if first == NONE else "effect"), named, stated


def sentence(
    kind: Kind,
    effects: Sequence[str],
    stated: Sequence[str],
    probabilities: Mapping[str, float],
    floor: bool = True,
    partly: Mapping[str, float] | None = None,
) -> str:
    """The verdict in plain words.

    Args:
        floor: whether trials were repeated.
        partly: hypotheses that explain a share of what is missing, told where not all of it is explained.
    """
    if kind == "complete" and not floor:
        return (
            f"No effect of the library explains more ({probabilities[NONE]:.0%}); whether what is left is noise, one "
            "trial does not tell."
        )
    if kind == "complete":
        return f"Nothing is missing within the noise ({probabilities[NONE]:.0%})."
    if kind == "unknown":
        most = [f"{_hypothesis(name)} explains {share:.0%} of it" for name, share in (partly or {}).items()]
        part = f", though {' and '.join(most)}" if most else ""
        return (
            f"Something is missing that no known effect explains in full ({probabilities[UNKNOWN]:.0%}){part}; "
            "look at what is left over speed, position and time."
        )
    if kind == "effect":
        sure = probabilities[stated[0]]
        return f"The model lacks {' and '.join(map(in_words, effects))} ({sure:.0%})."
    told = [f"{_hypothesis(name)} ({probabilities[name]:.0%})" for name in stated]
    return f"These recordings do not decide between {', '.join(told[:-1])} and {told[-1]}."


def in_words(name: str) -> str:
    """A candidate as people say it: "backlash on x"."""
    effect, _, place = name.partition(".")
    known = library_effects()
    title = known[effect].title if effect in known else effect
    return f"{title[0].lower()}{title[1:]} on {'the ball' if place == 'ball' else place}"


def _hypothesis(name: str) -> str:
    if name == NONE:
        return "nothing missing"
    if name == UNKNOWN:
        return "something unknown"
    return " with ".join(in_words(part) for part in name.split(" + "))


def _plain(content: Any) -> Any:
    if isinstance(content, dict):
        return {str(key): _plain(value) for key, value in content.items()}
    if isinstance(content, list | tuple):
        return [_plain(value) for value in content]
    if isinstance(content, float):
        return content if math.isfinite(content) else None
    return content
