# SPDX-License-Identifier: Apache-2.0
"""Adding named effects to a model: fitted together with the base values, proved on samples kept from the fit."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from eps_tunnel_analysis.diagnose.axis_search import ROUNDS, Progress, axis_parts, axis_search, ball_part
from eps_tunnel_analysis.diagnose.ball import BALL, sees_ball, split, without_ball
from eps_tunnel_analysis.diagnose.base_refit import base_refit
from eps_tunnel_analysis.diagnose.bases import fitted_bases
from eps_tunnel_analysis.diagnose.candidates import Candidate
from eps_tunnel_analysis.diagnose.diagnose import compared, errors_of, is_moved
from eps_tunnel_analysis.diagnose.refit import Refit
from eps_tunnel_analysis.diagnose.search import Search
from eps_tunnel_analysis.diagnose.verdict import Errors
from eps_tunnel_analysis.plays import Play
from labyrinth_sim.effect import effects as library_effects
from labyrinth_sim.errors import InputError, unknown_name
from labyrinth_sim.model import Model

STARTS = 6  # looks that are descended


@dataclass(frozen=True)
class Addition:
    """A model with effects added.

    Attributes:
        model: with the effects, everything fitted.
        before, after: errors with the values refitted, without and with the effects; of the ball, in m, where all of
            them act on it.
        values: what was fitted.
    """

    model: Model
    before: Errors
    after: Errors
    values: Mapping[str, float]

    @property
    def sentence(self) -> str:
        """Whether it helped, in words."""
        fall = 1.0 - self.after.held_out / self.before.held_out if self.before.held_out else 0.0
        if fall <= 0.0:
            return f"On samples held out the error did not fall ({-fall:.0%} more): leave it out."
        return f"On samples held out the error fell by {fall:.0%}, alikeness from {self.before.alikeness:.0%} to " \
            f"{self.after.alikeness:.0%}."  # fmt: skip

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return {
            "before": asdict(self.before),
            "after": asdict(self.after),
            "values": dict(self.values),
            "sentence": self.sentence,
        }


def add_effects(
    model: Model,
    plays: Sequence[Play],
    names: Sequence[str],
    nthread: int = 0,
    told: Progress | None = None,
    held: Sequence[Play] = (),
) -> Addition:
    """Adds effects by name (`backlash.x`), those of one axis fitted together.

    Args:
        told: what is being done and how many roll-outs were made.
        held: plays that are never fitted, for the held-out error.

    Raises:
        InputError: unknown names or places, or an axis that was not measured.
    """
    known = library_effects()
    complaints = [unknown_name("effect", n.partition(".")[0], known) for n in names if n.partition(".")[0] not in known]
    if complaints:
        raise InputError(complaints)
    base_model, final = model, model
    values: dict[str, float] = {}
    left = list(dict.fromkeys(names))
    on_axes, on_ball = split([n.partition(".")[0] for n in names])
    rolls = bool(on_ball) and sees_ball(model, plays)
    alone = [without_ball(p) for p in plays]
    parts = [p for p in axis_parts(model, alone) if is_moved(model, p, alone)]
    bases = fitted_bases(model, alone, parts, on_axes, nthread, told)
    for part in [*parts, ball_part()] if rolls else parts:
        ball = part.axis == BALL
        # It rolls as the axes tilt, so it is fitted last.
        search = axis_search(final if ball else bases.among(model, part.axis), plays if ball else alone, part,
                             only=on_ball if ball else on_axes if rolls else [*on_axes, *on_ball],
                             nthread=nthread, told=told)  # fmt: skip
        mine = [c for c in search.library.candidates if c.name in left]
        left = [n for n in left if n not in [c.name for c in mine]]
        base = base_refit(search, bases.values.get(part.axis))
        best = _fitted(search, base, mine)
        numbers = dict(zip(search.library.names, (float(v) for v in best.values), strict=True))
        fitted = dict(zip(search.library.names, (float(v) for v in base.values), strict=True))
        base_model = base_model.with_values({n: fitted[n] for n in part.base}, "add-effect")
        final = final.with_values({n: numbers[n] for n in part.base}, "add-effect")
        for candidate in mine:
            final = final.with_effect(candidate.effect, candidate.place)
            final = final.with_values({n: numbers[n] for n in candidate.parameters}, "add-effect")
        values |= {n: numbers[n] for n in (*part.base, *(p for c in mine for p in c.parameters))}
    if left:
        valid = [f"{e.name}.{place}" for e in known.values() for place in model.places(e)]
        raise InputError([unknown_name("effect and place", n, valid) for n in left])
    unit = "m" if rolls and not on_axes else "rad"
    before, after = (
        errors_of(compared(m, plays if rolls else alone), compared(m, held), unit) for m in (base_model, final)
    )
    return Addition(final, before, after, values)


def _fitted(search: Search, base: Refit, candidates: Sequence[Candidate]) -> Refit:
    """The candidates one after the other, each from its best looks, on top of those before it."""
    best = base
    for candidate in candidates:
        search.settle_at(best)
        on = tuple(search.library.find(n) for n in best.effects)
        looks = search.looks([best], [candidate])[:STARTS]
        best = search.best_of([((*on, candidate), look.values) for look in looks], ROUNDS)[0]
    return best
