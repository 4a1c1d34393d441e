# SPDX-License-Identifier: Apache-2.0
"""What is named of a dependence before and after roll-outs: where formulas are tried, and what their result changes."""

from collections.abc import Mapping
from dataclasses import replace

from eps_tunnel_analysis.law.depends import OF_COMMAND, SWING, Dependence, Depends, traced
from eps_tunnel_analysis.law.formula import Formula


def ways(dependence: Depends) -> list[Dependence]:
    """What is named, and of what else explains more than chance the best of each kind that acts elsewhere.

    Between a force, the error of a sensor and that of the command roll-outs decide, each with a formula of its own: the
    linear problems are about different motions, and where the axis sticks or sags they are rough.
    """
    every = (d for d in (dependence.first, *dependence.ties, *dependence.dependences) if d is not None)
    ways: dict[tuple[str, str], Dependence] = {}
    for d in every:
        tied = d is dependence.first or d in dependence.ties
        kinds = {what for _, what in ways}
        if tied or (d.named and not d.pair and d.acts[1] not in kinds):
            ways.setdefault(d.acts, d)
    return list(ways.values())


def as_proposed(dependence: Depends, law: Formula, way: Dependence, share: float,
                interval: tuple[float, float]) -> Depends:  # fmt: skip
    """What is named, if the formula acts elsewhere or its first term depends on something else: roll-outs chose it.

    A constant that the formula does without is not named if the formula explains more than chance does.

    Args:
        share, interval: of the base's misfit on left-out stretches that the formula explains in roll-outs.
    """
    named, over = dependence.first, law.terms[0].term.over
    if named is None or (named.over == over and named.acts == way.acts):
        return dependence
    there = [d for d in dependence.dependences
             if d.over == over and d.acts == way.acts and not (d.pair or d.constant)]  # fmt: skip
    same = [d for d in there if d.named]
    if named.constant and all(c.term.over for c in law.terms):
        same = same or [replace(d, named=True, share=share, interval=interval) for d in there if share > d.chance]
    first = max(same, key=lambda d: d.share, default=way)
    return with_first(dependence, first)


def with_first(dependence: Depends, first: Dependence) -> Depends:
    """Something else named first, and what was named before as one of those that are not told apart from it."""
    every = dependence.dependences
    if first not in every:  # roll-outs gave it a share of its own
        key = (first.variable, first.acts, first.period)
        every = (first, *(d for d in every if (d.variable, d.acts, d.period) != key))
    ties = tuple(d for d in (dependence.first, *dependence.ties) if d is not None and d is not first)
    return replace(dependence, dependences=every, first=first, ties=ties)


def refuted(dependence: Depends) -> Depends:
    """What is named where roll-outs bear nothing out: no late command, which is the very formula that was tried."""
    kept = [d for d in (dependence.first, *dependence.ties) if d is not None and not d.late]
    return replace(dependence, first=next(iter(kept), None), ties=tuple(kept[1:]))


def with_period(dependence: Depends, law: Formula, turns: Mapping[str, float]) -> Depends:
    """What is named, with the period or the frequency that the formula has."""
    first = dependence.first
    if first is None or first.pair:
        return dependence
    swinging = [c.values for c in law.terms if c.term.over == first.over == SWING]
    if swinging:
        most = max(swinging, key=lambda values: values["inertia"] * values["frequency"] ** 2)
        return _named_as(dependence, replace(first, frequency=most["frequency"]))
    acts = {"curve_angle": "torque", "curve_angle_friction": "friction", "curve_sensor": "sensor", OF_COMMAND: "target"}
    waves = [c.values for c in law.terms if "period" in c.values and c.term.acts == acts.get(first.over)]
    if not waves:
        return dependence
    period = abs(max(waves, key=lambda values: abs(values["size"]))["period"])
    return _named_as(dependence, replace(first, period=period, traced=traced(period, turns)))


def _named_as(dependence: Depends, named: Dependence) -> Depends:
    """The same with what is named in the place of the first."""
    every = tuple(named if d is dependence.first else d for d in dependence.dependences)
    return replace(dependence, dependences=every, first=named)
