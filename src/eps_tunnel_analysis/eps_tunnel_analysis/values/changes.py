# SPDX-License-Identifier: Apache-2.0
"""What changed between two dates: one value of the model, or one effect, or nothing beyond the rig's own spread.

The model is fitted to what was recorded then, and kept. What is recorded now may differ by a few values or effects, for
example by wear, and sets of these are ranked as a diagnosis ranks missing effects. If the same command was played on
both dates, the model's misfit then is subtracted from that now: a form that is wrong on both is not a change.

Over many dates: how alike the model of the first one is, and how some of its values changed.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

import numpy as np

from eps_tunnel_analysis.alikeness import KS, joint_against_itself
from eps_tunnel_analysis.compare import compare
from eps_tunnel_analysis.diagnose.axis import near_hypotheses
from eps_tunnel_analysis.diagnose.axis_search import (
    AxisPart,
    SearchOptions,
    axis_parts,
    moved_parts,
    search_of,
)
from eps_tunnel_analysis.diagnose.ball import without_ball
from eps_tunnel_analysis.diagnose.base_values import fitted_bases
from eps_tunnel_analysis.diagnose.candidates import Candidate, Library, library
from eps_tunnel_analysis.diagnose.contained import ROUNDS
from eps_tunnel_analysis.diagnose.named_intervals import profiles
from eps_tunnel_analysis.diagnose.rank import NONE, UNKNOWN, Hypothesis, independent, joint, rank
from eps_tunnel_analysis.diagnose.refits import Refit
from eps_tunnel_analysis.diagnose.search import Search
from eps_tunnel_analysis.diagnose.sets import refitted_sets
from eps_tunnel_analysis.diagnose.settings import SETTINGS
from eps_tunnel_analysis.diagnose.verdict import decide, in_words, percent, undecided
from eps_tunnel_analysis.fit.intervals import intervals
from eps_tunnel_analysis.outputs import plain, shown_value
from eps_tunnel_analysis.recorded_play import Play
from eps_tunnel_analysis.simulated import Diverged, compared_signals, roll_out, same_commands
from labyrinth_sim.effect import Effect, Parameter
from labyrinth_sim.errors import InputError
from labyrinth_sim.model import Model

MOST_CHANGES = 2  # on one axis
STEP_OF_A_VALUE = 0.3  # of a value: the strength around which changes of it are tried, or
STEP_OF_ITS_SPAN = 0.05  # of its span, where that is more
#: Share of the noise floor to which differences of the same command on two dates are held before something is said to
#: have changed: a diagnosis leaves room for forms that are not exact, and these cancel in the difference.
#: Measured: an unchanged rig leaves 0.5 to 0.7 floors, and this puts the limit at 0.9.
PAIRED = 0.75

Outcome = Literal["nothing", "changed", "undecided", "unknown"]
OUTCOMES: Mapping[str, Outcome] = {
    "complete": "nothing",
    "effect": "changed",
    "undecided": "undecided",
    "unknown": "unknown",
}


@dataclass(frozen=True)
class ValueChange:
    """One value on two dates.

    Attributes:
        name, unit: the full parameter name and its unit.
        then, now: the value on each date, in that unit.
        half_width: of the 95 % interval of the difference, in that unit.
        what: the value or effect that it belongs to, by its name in the result.
    """

    name: str
    unit: str
    then: float
    now: float
    half_width: float
    what: str

    @property
    def change(self) -> float:
        """Now less then."""
        return self.now - self.then

    @property
    def sentence(self) -> str:
        """In the units that people read."""
        then, now, change, half = (
            shown_value(v, self.unit) for v in (self.then, self.now, self.change, self.half_width)
        )
        return f"{self.name} went from {then} to {now}: {change} ± {half}."


@dataclass(frozen=True)
class Changes:
    """What changed.

    Attributes:
        outcome: "nothing" beyond the rig's own spread; "changed": `named` did; "undecided" between the `stated`;
            "unknown": something that no single value or effect explains.
        named: values and effects, as `drive.x.p` or `backlash.x`; the most probable where undecided.
        set: hypotheses with their probabilities, "none" and "unknown" among them.
        stated: the smallest part of `set` that holds the truth with probability 0.9.
        values: what each named one was and is.
        floors: axis -> mean square of the difference in units of what the trials' spread allows: if nothing had
            changed, and with the named changes. An unchanged rig leaves 1.
        paired: how many of the plays of now have a command that was also played then, and of how many.
        model: fitted to what was recorded then.
        notes: what could not be known.
    """

    outcome: Outcome
    named: tuple[str, ...]
    set: Mapping[str, float]
    stated: tuple[str, ...]
    values: tuple[ValueChange, ...]
    floors: Mapping[str, tuple[float, float]]
    paired: tuple[int, int]
    model: Model
    notes: tuple[str, ...] = ()

    @property
    def sentence(self) -> str:
        """The outcome in plain words."""
        sure = percent(self.set[self.stated[0]])
        words = [_in_words(name, self.model) for name in self.named]
        if self.outcome == "nothing":
            return f"Nothing changed beyond the rig's own spread ({sure})."
        if self.outcome == "changed":
            return f"What changed is {' and '.join(words)} ({sure})."
        if self.outcome == "unknown":
            return f"Something changed that no single value or effect explains ({sure})."
        options = [
            f"{' with '.join(_in_words(part, self.model) for part in name.split(' + '))} ({percent(self.set[name])})"
            for name in self.stated
        ]
        return undecided(options)

    def to_json(self) -> dict[str, Any]:
        """Plain dicts, lists, numbers and words; SI units."""
        content = {
            "outcome": self.outcome,
            "named": list(self.named),
            "set": dict(self.set),
            "stated_set": list(self.stated),
            "sentence": self.sentence,
            "values": [{**asdict(v), "change": v.change} for v in self.values],
            "floors": {axis: list(pair) for axis, pair in self.floors.items()},
            "paired_plays": list(self.paired),
            "notes": list(self.notes),
        }
        found: dict[str, Any] = plain(content)
        return found


@dataclass(frozen=True)
class _AxisChanges:
    search: Search
    base: Refit
    refits: tuple[Refit, ...]
    probabilities: Mapping[str, float]

    def of(self, names: Sequence[str]) -> Refit:
        """The refit of those of these names that are on this axis."""
        own = {c.name for c in self.search.library.candidates} & set(names)
        return next((r for r in self.refits if set(r.effects) == own), self.base)


def changes(
    model: Model,
    then: Sequence[Play],
    now: Sequence[Play],
    only: Sequence[str] | None = None,
    keep_values: bool = False,
    run: SearchOptions | None = None,
) -> Changes:
    """Names what changed between two dates.

    Args:
        model: of the rig as it was then, with the effects that it had.
        then, now: recorded commands with their trials.
        only: what to consider: values as `drive.x.p`, effects as `backlash` or `backlash.x`; all by default.
        keep_values: take the model's values as they are, instead of fitting them to `then` first.
        run: threads and progress.

    Raises:
        InputError: no axis that was measured and moved on both dates, or unknown names.
    """
    run = run or SearchOptions()
    then, now = [without_ball(p) for p in then], [without_ball(p) for p in now]
    parts = moved_parts(model, axis_parts(model, [*then, *now]), now)
    if not keep_values:
        model = fitted_then(model, then, parts, run)
    chosen = _chosen(model, parts, only)
    axes = [_axis_changes(chosen[part.name], then, now, part, run) for part in parts]
    probabilities = joint([axis.probabilities for axis in axes])
    kind, named, stated = decide(probabilities, SETTINGS.coverage)
    single = any(play.trials.count == 1 for play in (*then, *now))
    floors = {part.name: (axis.base.cost, axis.of(named).cost) for part, axis in zip(parts, axes, strict=True)}
    return Changes(
        outcome=OUTCOMES[kind],
        named=named,
        set=probabilities,
        stated=stated,
        values=tuple(v for axis in axes for v in _value_changes(model, axis, named)),
        floors=floors,
        paired=(sum(_as_then(play, then) is not None for play in now), len(now)),
        model=model,
        notes=("One trial only: how well the rig repeats is unknown, so small changes are not seen. Record five.",)
        if single
        else (),
    )


def fitted_then(model: Model, then: Sequence[Play], parts: Sequence[AxisPart], run: SearchOptions) -> Model:
    """The model with every axis's values fitted to what was recorded then."""
    values = fitted_bases(model, then, parts, replace(run, only=())).values
    return model.with_values(values, "fitted to what was recorded then")


def refitted(
    model: Model, then: Sequence[Play], now: Sequence[Play], names: Sequence[str], run: SearchOptions | None = None
) -> tuple[ValueChange, ...]:
    """What these values and effects are now, given that nothing else changed.

    Args:
        model: fitted to what was recorded then, as `Changes.model`.
        names: as `Changes.named`.
    """
    run = run or SearchOptions()
    then, now = [without_ball(p) for p in then], [without_ball(p) for p in now]
    value_changes: list[ValueChange] = []
    parts = moved_parts(model, axis_parts(model, [*then, *now]), now)
    chosen = _chosen(model, parts, names)
    for part in parts:
        if not chosen[part.name].candidates:
            continue
        search, base = _search(chosen[part.name], then, now, part, run)
        search.settle_at(base)
        points = search.trial_points([base], search.library.candidates)
        start = base.values.copy()
        for candidate in search.library.candidates:
            first = next(p for p in points if p.candidate.name == candidate.name)
            columns = search.columns(candidate)
            start[columns] = first.values[columns]
        every = tuple(search.library.candidates)
        refit = min(search.judged([(every, start), (every, base.values)], ROUNDS), key=lambda r: r.cost)
        value_changes += _value_changes(model, _AxisChanges(search, base, (refit,), {}), names)
    return tuple(value_changes)


def _chosen(model: Model, parts: Sequence[AxisPart], only: Sequence[str] | None) -> dict[str, Library]:
    """For each axis what can have changed there, and the model that holds it all as it was then."""
    own = {part.name: _value_candidates(model, part) for part in parts}
    known = [c.name for libraries in own.values() for c in libraries]
    wanted = None if only is None else [n for n in only if n not in known and n not in {k.split(".")[0] for k in known}]
    if wanted:
        try:
            model.registry.check(wanted)
        except InputError as error:
            raise InputError([*error.complaints, f"Values that can change: {', '.join(known)}."]) from error
    # An effect without a place means the one in the model and, elsewhere, one that may have appeared.
    new = None if only is None else [n for n in only if n.partition(".")[0] in model.registry.effects]
    lib = library(model, (), False, new)
    libraries: dict[str, Library] = {}
    for part in parts:
        candidates = [c for c in lib.candidates if c.axes == (part.name,)]
        candidates += [c for c in own[part.name] if only is None or c.name in only or c.name.partition(".")[0] in only]
        held = lib.model
        for other in lib.candidates:
            if other not in candidates:
                held = held.without_effect(other.effect.name, other.place)
        libraries[part.name] = Library(held, (), tuple(candidates))
    return libraries


def _value_candidates(model: Model, part: AxisPart) -> list[Candidate]:
    """The drive's values, each by itself, and the effects that the model has, as candidates that are off as then."""
    infos, candidates = model.parameters(), list[Candidate]()
    for name in part.base:
        if name.startswith("drive."):
            owner, _, short = name.rpartition(".")
            p = next(p for p in model.drives[part.name].kind.parameters if p.name == short)
            step = max(STEP_OF_A_VALUE * abs(infos[name].value), STEP_OF_ITS_SPAN * infos[name].span)
            moved = _moved(p, infos[name].value, infos[name].low, infos[name].high, step)
            candidates.append(Candidate(_value_as_effect(owner, moved), short, (part.name,), (name,)))
    for use in model.effects:
        prefix = f"{use.effect.name}.{use.place}."
        main = [p for p in use.effect.parameters if p.fitted and p.off is not None and f"{prefix}{p.name}" in part.base]
        moved_all = tuple(
            _moved(p, (i := infos[f"{prefix}{p.name}"]).value, i.low, i.high, 0.5 * abs(p.typical - (p.off or 0.0)))
            for p in main
        )
        if main:
            effect = replace(use.effect, parameters=moved_all)
            candidates.append(Candidate(effect, use.place, (part.name,), tuple(f"{prefix}{p.name}" for p in main)))
    return candidates


def _moved(p: Parameter, value: float, low: float, high: float, step: float) -> Parameter:
    """A parameter that vanishes at a value, and whose typical strength is a step away from it."""
    off = min(max(value, low), high)
    typical = off + step if off + step <= high else max(off - step, low)
    return replace(p, low=low, high=high, off=off, typical=typical)


def _value_as_effect(owner: str, p: Parameter) -> Effect:
    """A change of one of a drive's values, in the form of an effect."""
    return Effect(
        name=owner, title=owner, physics="", equation="", parameters=(p,), stage="drive", mark="", shows="passing",
        confused_with=(), separated_by="",
    )  # fmt: skip


def _search(
    lib: Library, then: Sequence[Play], now: Sequence[Play], part: AxisPart, run: SearchOptions
) -> tuple[Search, Refit]:
    """The search over what may have changed on one axis, and what is left if nothing has."""
    search = search_of(lib, now, part, run)
    before = search_of(lib, then, part, run)
    used = np.zeros(len(before.evidence.time), dtype=bool)
    used[before.used] = True
    scale_then = np.full(len(used), np.nan)
    scale_then[before.used] = before.scale
    missed_then = before.levels["exact"](before.start[None])[0]
    signals = len(part.signals)
    missed, scale = np.zeros(len(search.evidence.time)), np.zeros(len(search.evidence.time))
    scale[search.used] = search.scale
    for number, play in enumerate(now):
        other = _as_then(play, then)
        for column in range(signals):
            here = search.evidence.blocks == number * signals + column
            same_signal = before.evidence.blocks % signals == column
            if other is None:  # nothing to compare with: a misfit like that of then is not a change
                rms = np.sqrt(np.mean(missed_then[same_signal & used] ** 2)) if (same_signal & used).any() else 0.0
                scale[here] = np.hypot(scale[here], rms)
                continue
            there = before.evidence.blocks == other * signals + column
            at, old = search.evidence.time[here], before.evidence.time[there]
            missed[here] = np.interp(at, old, missed_then[there])
            clear = there & used
            if clear.any():
                old_scale = np.interp(at, before.evidence.time[clear], scale_then[clear])
                scale[here] = np.hypot(scale[here], old_scale)
    search.levels = {level: evidence.less(missed) for level, evidence in search.levels.items()}
    search.scale = scale[search.used]
    residuals = search.residuals(search.start[None], "exact")[0]
    return search, Refit((), search.start, residuals, float(np.mean(residuals**2)), 0, True)


def _as_then(play: Play, then: Sequence[Play]) -> int | None:
    """Number of the play of then with the same command and the same known values, None where there is none."""
    for number, other in enumerate(then):
        if play.known != other.known or play.trials.command_channels != other.trials.command_channels:
            continue
        if abs(play.trials.step - other.trials.step) > 1e-9:
            continue
        size = min(len(play.trials.time), len(other.trials.time))
        if max(len(play.trials.time), len(other.trials.time)) > size + 0.02 * size:
            continue
        if same_commands(np.stack([play.trials.commands[0, :size], other.trials.commands[0, :size]])):
            return number
    return None


def _axis_changes(
    lib: Library, then: Sequence[Play], now: Sequence[Play], part: AxisPart, run: SearchOptions
) -> _AxisChanges:
    search, base = _search(lib, then, now, part, run)
    share = PAIRED if all(_as_then(play, then) is not None for play in now) else 1.0
    base, refits = refitted_sets(search, base, share**2 * SETTINGS.healthy, most=MOST_CHANGES)
    folds = search.folds
    hypotheses = near_hypotheses(search, base, refits)
    tried = len(search.library.candidates)
    alone = Hypothesis(base, base.residuals)
    named = rank(alone, hypotheses, folds, search.blocks, tried).probabilities
    strict = rank(_in_units(alone, share), [_in_units(h, share) for h in hypotheses], folds, search.blocks, tried)
    none = strict.probabilities[NONE]
    if share < 1.0 and hypotheses:
        none = min(none, _unchanged(alone, min(hypotheses, key=lambda h: h.cost), search, tried))
    return _AxisChanges(search, base, tuple(refits), _with_none(named, none))


def _unchanged(base: Hypothesis, best: Hypothesis, search: Search, tried: int) -> float:
    """Probability that nothing changed, where the same command was played on both dates.

    As a wrong form cancels, what one change explains on stretches of time that were left out of its fit counts in full
    as evidence (Schwarz 1978); it must also be material.
    """
    gain = base.cost - best.cost
    if gain <= 0.0:
        return 1.0
    worth = max(independent(best.left_out, search.blocks), 1.0)
    evidence = 0.5 * worth * gain / max(best.cost, 1.0) - np.log(max(tried, 1)) - 0.5 * best.refit.free * np.log(worth)
    visible = np.log(gain / (PAIRED**2 * SETTINGS.material)) / SETTINGS.width
    changed = [1.0 / (1.0 + np.exp(-np.clip(x, -50.0, 50.0))) for x in (evidence, visible)]
    return float(1.0 - changed[0] * changed[1])


def _in_units(h: Hypothesis, share: float) -> Hypothesis:
    """A hypothesis in units of a share of the noise floor."""
    refit = replace(h.refit, residuals=h.refit.residuals / share, cost=h.refit.cost / share**2)
    return replace(h, refit=refit, left_out=h.left_out / share)


def _with_none(probabilities: Mapping[str, float], none: float) -> dict[str, float]:
    """Probabilities with another one that nothing changed, the others in proportion."""
    rest = 1.0 - probabilities[NONE]
    if rest <= 0.0:
        return {name: float(name == NONE) for name in probabilities}
    return {name: none if name == NONE else p * (1.0 - none) / rest for name, p in probabilities.items()}


def _value_changes(model: Model, axis: _AxisChanges, named: Sequence[str]) -> list[ValueChange]:
    """The values of the named changes on one axis, with the intervals of what they changed by."""
    refit, search = axis.of(named), axis.search
    if not refit.effects:
        return []
    columns = search.fitted(refit)
    interval = intervals(search.jacobian(refit), refit.residuals, search.blocks.astype(float))
    half = np.maximum(interval.half_width * search.spans[columns], profiles(search, refit, columns))
    units = {name: info.unit for name, info in search.library.model.parameters().items()}
    owner = {p: c for c in map(search.library.find, refit.effects) for p in c.parameters}
    present = model.values()
    changed = []
    for column, width in zip(columns, half, strict=True):
        name = search.library.names[column]
        declared = next(p for p in owner[name].declared if name.endswith(f".{p.name}"))
        if declared.off is None:  # shapes an effect that was not there, so it had no value then
            continue
        before = present.get(name, declared.off)
        changed.append(
            ValueChange(name, units[name], float(before), float(refit.values[column]), float(width), owner[name].name)
        )
    return changed


def _in_words(name: str, model: Model) -> str:
    """A hypothesis in words."""
    if name == NONE:
        return "nothing changed"
    if name == UNKNOWN:
        return "something unknown"
    if name.startswith("drive."):
        return name
    return in_words(name, model.registry)


@dataclass(frozen=True)
class DateOfRig:
    """One date.

    Attributes:
        label: as the user named it.
        alikeness: k -> share of all seen samples alike in every signal, of the model of the first date.
        itself: k -> what the rig reached against itself on this date, jointly; NaN with too few trials.
        values: what the watched values are, given that nothing else changed; none for the first date.
    """

    label: str
    alikeness: Mapping[float, float]
    itself: Mapping[float, float]
    values: tuple[ValueChange, ...]

    def to_json(self) -> dict[str, Any]:
        """Plain dicts, lists, numbers and words; SI units."""
        found: dict[str, Any] = plain(
            {
                "label": self.label,
                "alikeness": [
                    {"k": k, "joint": share, "rig_against_itself": self.itself[k]}
                    for k, share in self.alikeness.items()
                ],
                "values": [asdict(v) for v in self.values],
            }
        )
        return found


def over_dates(
    model: Model,
    dates: Mapping[str, Sequence[Play]],
    watched: Sequence[str],
    ks: Sequence[float] = KS,
    run: SearchOptions | None = None,
) -> tuple[DateOfRig, ...]:
    """Alikeness and watched values on each date.

    Args:
        model: fitted to the first date.
        dates: label -> what was recorded, the first one first.
        watched: values and effects, as `Changes.named`.
    """
    first = next(iter(dates.values()))
    rows = []
    for label, plays in dates.items():
        values = refitted(model, first, plays, watched, run) if watched and plays is not first else ()
        rows.append(DateOfRig(label, _alikeness(model, plays, ks), _itself(model, plays, ks), values))
    return tuple(rows)


def _itself(model: Model, plays: Sequence[Play], ks: Sequence[float]) -> dict[float, float]:
    names = compared_signals(model, [play.trials for play in plays])
    return joint_against_itself([play.trials.select(names) for play in plays], sorted(ks))


def _alikeness(model: Model, plays: Sequence[Play], ks: Sequence[float]) -> dict[float, float]:
    names = compared_signals(model, [play.trials for play in plays])
    alike, seen = dict.fromkeys(sorted(ks), 0.0), 0.0
    for play in plays:
        real = play.trials.select(names)
        try:
            comparison = compare(real, roll_out(model, play), ks, signals=names)
        except Diverged:
            continue
        seen += float(comparison.alikeness[0].seen.all(axis=1).sum())
        for a in comparison.alikeness:
            alike[a.k_real] += float(a.alike.all(axis=1).sum())
    return {k: count / max(seen, 1.0) for k, count in alike.items()}
