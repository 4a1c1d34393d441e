# SPDX-License-Identifier: Apache-2.0
"""What is proposed if no effect of the library explains what is missing: an effect file with a formula, or a curve.

Both are refitted in whole roll-outs together with the base values, and judged on stretches of time that were left out.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from eps_tunnel_analysis.diagnose.added_force import visited
from eps_tunnel_analysis.diagnose.axes import Diagnosis
from eps_tunnel_analysis.diagnose.axis import AxisDiagnosis, floor_known, hypothesis
from eps_tunnel_analysis.diagnose.axis_search import AxisPart, SearchOptions, axis_parts, search_of
from eps_tunnel_analysis.diagnose.ball import BALL, without_ball
from eps_tunnel_analysis.diagnose.candidates import Candidate, Library, with_curves
from eps_tunnel_analysis.diagnose.rank import NONE, UNKNOWN, Hypothesis, rank
from eps_tunnel_analysis.diagnose.refits import lowest
from eps_tunnel_analysis.diagnose.search import Search
from eps_tunnel_analysis.diagnose.settings import SETTINGS
from eps_tunnel_analysis.diagnose.verdict import percent
from eps_tunnel_analysis.law.depends import Dependence, Depends, depends
from eps_tunnel_analysis.law.design import COMMAND, Design, Predictor, half_widths
from eps_tunnel_analysis.law.effect_file import NAME, declared, effect_file, equation_of, prefixes, seen_mark
from eps_tunnel_analysis.law.formula import Chosen, Formula, dictionaries, formulas
from eps_tunnel_analysis.law.missing_force import (
    MissingForce,
    MissingOffset,
    missing_force,
    missing_offset,
    trial_offsets,
)
from eps_tunnel_analysis.law.naming import as_proposed, refuted, ways, with_first, with_period
from eps_tunnel_analysis.law.refit import Visit, floors_on, library_of, visit
from eps_tunnel_analysis.law.single_terms import explained_by, single_terms
from eps_tunnel_analysis.law.variables import OVER_SPEED, knots_of, sensors, variables
from eps_tunnel_analysis.outputs import shown_number, shown_value
from eps_tunnel_analysis.recorded_play import Play
from eps_tunnel_analysis.sequence import Command
from labyrinth_sim.curve import NAMES
from labyrinth_sim.effect import effects, slide_unit
from labyrinth_sim.model import Model, save_model
from labyrinth_sim.rig import Rig
from labyrinth_sim.shown import shown
from labyrinth_sim.simulate import simulate_batch
from labyrinth_sim.trials import Array

LAW_ROUNDS = 15  # of descent at most; after a few, chance decides between a formula and a curve


@dataclass(frozen=True)
class Refitted:
    """A proposal in roll-outs.

    Attributes:
        values: full parameter name -> fitted number.
        intervals: the same -> half of its 90 % interval.
        units: the same -> SI unit of both.
        floors: left of all samples; `held_out`: of stretches of time that were left out.
    """

    values: Mapping[str, float]
    intervals: Mapping[str, float]
    units: Mapping[str, str]
    floors: float
    held_out: float


@shown
@dataclass(frozen=True)
class Confirmation:
    """Test of a proposal on another command: mean square in units of the noise floor, without it and with it."""

    before: float
    after: float

    @property
    def holds(self) -> bool:
        """Whether it takes away half of what is to be explained."""
        return self.after <= self.before - SETTINGS.law_confirmed * (self.before - min(self.before, 1.0)) < self.before

    @property
    def sentence(self) -> str:
        """In words."""
        how = "Confirmed" if self.holds else "Not confirmed"
        return (
            f"{how} on another command: {shown_number(self.before)} floors are left there without it, "
            f"{shown_number(self.after)} with it."
        )


@dataclass(frozen=True)
class Proposal:
    """What is proposed for one axis.

    Attributes:
        axis: its name; `place`: the axis or the sensor that it acts on.
        missing, depends, formula: what it rests on.
        kind: "formula", "curve", or "" if nothing is proposed.
        effect: the effect's full name with its place.
        text: of the file that declares it; "" for a curve, which the library has.
        equation: for people.
        refit: in roll-outs; None if nothing is proposed.
        base_held_out: floors that the model leaves without it on left-out stretches.
        base: the model without it, refitted; `model` with the proposal added and fitted.
        curve: what is missing over the variable named, as (variable, force) at ten places, without any formula;
            `curve_band`: half of the 90 % interval at each.
        visit: the command that shows it best, where something is named.
        confirmation: its test on another command; None until one was played.
        tried: equation -> floors left on left-out stretches, of each set of terms that was refitted and does not
            run away.
        ranked: set of effects, "none" or "unknown" -> probability, the proposal ranked as one candidate among the sets
            that the diagnosis found best; empty if nothing is proposed.
        also: what else lacks a force: the load's side of an elastic axis, other axes.
        offsets: the error of each sensor, if it alone caused the misfit; only if several measure the axis.
        left: the force that is still missing in addition to what is proposed.
        trials: signal -> (p, 2) number of each trial, by how much it differs from the others of its play.
    """

    axis: str
    place: str
    missing: MissingForce
    depends: Depends
    formula: Formula
    kind: str = ""
    effect: str = ""
    text: str = ""
    equation: str = ""
    refit: Refitted | None = None
    base_held_out: float = float("nan")
    base: Model | None = None
    model: Model | None = None
    curve: tuple[tuple[float, float], ...] = ()
    visit: Visit | None = None
    confirmation: Confirmation | None = None
    tried: Mapping[str, float] = field(default_factory=dict)
    ranked: Mapping[str, float] = field(default_factory=dict)
    also: tuple[MissingForce, ...] = ()
    offsets: tuple[MissingOffset, ...] = ()
    left: MissingForce | None = None
    trials: Mapping[str, Array] = field(default_factory=dict)
    curve_band: tuple[float, ...] = ()

    @property
    def probability(self) -> float:
        """Of the proposal, among the best sets of known effects; NaN if nothing is proposed."""
        return self.ranked.get(self.effect, float("nan"))

    @property
    def position_unit(self) -> str:
        """SI unit of the axis's position."""
        return "m" if self.missing.unit == "N" else "rad"

    @property
    def sentence(self) -> str:
        """What is found, in words."""
        first = self.depends.first
        if first is None:
            text = f"Axis {self.axis}: what is missing depends on none of the variables more than by chance."
            return text + (f" {self.visit.name}.yaml would show more." if self.visit else "")
        waves = f", with a period of {shown_value(first.period, self.position_unit, 4)}" if first.period else ""
        waves += f", which is {first.traced}" if first.traced else ""
        low, high = first.interval
        if first.constant:
            what = f"is a {first.variable}"
        elif first.frequency:
            what = f"looks like a mass that swings on it at {first.frequency / (2.0 * np.pi):.3g} Hz"
        elif first.late:
            what = f"looks like {first.variable}"
        else:
            what = f"depends on {self.depends.words}{waves}"
        text = (
            f"Axis {self.axis}: what is missing {what}; that predicts "
            f"{first.share:.0%} ({low:.0%} to {high:.0%}) of it where that was left out of the fit, chance "
            f"{max(self.chance, 0.0):.0%}."
        )
        if self.refit:
            form = f"{self.equation}" if self.kind == "formula" else "a free curve"
            text += (
                f" Proposed is {form}: on data left out of the fit {shown_number(self.refit.held_out, 2)} floors "
                f"remain, {shown_number(self.base_held_out)} without it. "
            )
            beside = [name for name in self.ranked if name not in (self.effect, NONE, UNKNOWN)]
            text += f"Ranked with {len(beside)} sets of known effects" if beside else "Ranked by the same rule"
            text += f", its probability is {percent(self.probability)}. "
            text += self.confirmation.sentence if self.confirmation else "Found in these data, not confirmed."
        if self.depends.ties and self.visit:
            text += f" These recordings do not decide whether it is {self.depends.words}; {self.visit.name}.yaml may."
        return text

    @property
    def chance(self) -> float:
        """Share that a variable moved in time explains by chance, at most."""
        return self.depends.chance

    def write(self, folder: Path) -> None:
        """Writes what is proposed: the effect's file if it is a formula, and the model with it."""
        if self.text:
            with (folder / f"{NAME}.py").open("x", encoding="utf-8") as out:
                out.write(self.text)
        if self.model is not None:
            save_model(self.model, folder / "proposed_model.yaml")
        if self.visit is not None:
            (folder / f"{self.visit.name}.yaml").write_text(self.visit.to_yaml(), encoding="utf-8")

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        refit = None if self.refit is None else asdict(self.refit)
        return {
            "effect": self.effect or None,
            "kind": self.kind or None,
            "file": f"{NAME}.py" if self.text else None,
            "equation": self.equation or None,
            "place": self.place,
            "sentence": self.sentence,
            "confirmed": None if self.confirmation is None else self.confirmation.holds,
            "other_command": None if self.confirmation is None else asdict(self.confirmation),
            "not_told_apart": [d.variable for d in self.depends.ties],
            "curve": [list(point) for point in self.curve],
            "visit": None if self.visit is None else f"{self.visit.name}.yaml",
            "curve_band": list(self.curve_band),
            "curve_units": list(self.curve_units),
            "floors": list(self.missing.floors),
            "depends_on": [asdict(d) | {"period_unit": self.position_unit} for d in self.depends.dependences],
            "terms": [{"term": c.term.equation, **c.values, "units": self._units(c)} for c in self.formula.terms],
            "tried": dict(self.tried),
            "probability": self.probability if self.ranked else None,
            "ranked": dict(self.ranked),
            "also": [_missing_json(m) for m in self.also],
            "offsets": [o.to_json() for o in self.offsets],
            "missing": _missing_json(self.missing),
            "left": None if self.left is None else _missing_json(self.left),
            "trials": {name: rows.tolist() for name, rows in self.trials.items()},
            "refit": refit,
            "base_held_out": self.base_held_out if self.refit else None,
        }

    @property
    def curve_units(self) -> tuple[str, str]:
        """SI units of the two columns of `curve`: of the variable named, and of what is missing."""
        first = self.depends.first
        force, position = self.missing.unit, self.position_unit
        over = dict.fromkeys(OVER_SPEED, f"{position}/s") | {"curve_load_friction": force, "curve_reversal": "s"}
        over |= {"curve_time": "s", "curve_time_friction": "s"}
        if first is None:
            return position, force
        return over.get(first.curve, position), position if first.of_sensor or first.of_command else force

    def _units(self, chosen: Chosen) -> dict[str, str]:
        slides = self.missing.unit == "N"
        return {n.name: slide_unit(n.unit) if slides and n.name != "phase" else n.unit for n in chosen.term.numbers}


def _missing_json(missing: MissingForce) -> dict[str, Any]:
    return {"axis": missing.axis, "side": missing.side, "unit": missing.unit, "floors": list(missing.floors),
            "root_mean_square": missing.size}  # fmt: skip


@dataclass(frozen=True)
class _Attempt:
    """A formula or a free curve, refitted; `way` is what was named where it acts."""

    kind: str
    way: Dependence
    effect: str
    law: Formula
    refit: Refitted
    model: Model
    own: Hypothesis
    search: Search

    @property
    def over(self) -> tuple[tuple[str, str], str]:
        """Where a formula acts, and what its first term is over."""
        return self.way.acts, self.law.terms[0].term.over

    @property
    def numbers(self) -> int:
        return sum(len(c.term.numbers) for c in self.law.terms)


def propose(
    model: Model, plays: Sequence[Play], part: AxisPart, nthread: int = 0, seed: int = 0,
    beside: AxisDiagnosis | None = None,
) -> Proposal:  # fmt: skip
    """What one axis lacks, if no effect of the library explains it.

    Args:
        model: with its values refitted.
        plays: recorded.
        part: of the axis.
        beside: the diagnosis of the axis, with whose best sets the proposal is ranked.
    """
    missing = missing_force(model, plays, part, nthread, commanded=True)
    nothing = Formula((), 0.0, (0.0, 0.0))
    if missing.worst <= SETTINGS.healthy:
        return Proposal(part.name, part.name, missing, Depends(()), nothing)
    design = Design.of(missing)
    positions = [signal for signal in model.rig.positions if signal in part.signals]
    dependence = depends(design, positions, seed, ratios(model.rig, part.name))
    first, motions = dependence.first, [p.motion for p in design.plays]
    shows = visit(model, part.name, first or dependence.dependences[0], motions)
    offsets = tuple(missing_offset(missing, number) for number in sensors(design, positions))
    trials = trial_offsets(plays, positions)
    bare = Proposal(part.name, part.name, missing, dependence, nothing, base=model, visit=shows, offsets=offsets,
                    trials=trials)  # fmt: skip
    spans = visited(motions)
    sensed = {"curve_sensor": "curve_angle", "curve_sensor_speed": "curve_speed", "curve_sensor_other": "curve_other"}
    spans |= {name: spans[over] for name, over in sensed.items() if over in spans}
    run = SearchOptions((), nthread)
    every = dictionaries(design, positions)
    words = {acts: (place, terms) for acts, place, terms in every}
    stated = beside.search.library.base_of(beside.search.start) if beside else {}

    def attempts(laws: Iterable[Formula], way: Dependence) -> list[_Attempt]:
        refitted = (_formula_refitted(law, way, model, plays, part, run, stated) for law in laws)
        return [attempt for attempt in refitted if not runs_away(attempt.model, shows.command, nthread)]

    tried: list[_Attempt] = []
    named = ways(dependence)
    places = {way.acts for way in named}
    for way in named:
        place, terms = words[way.acts]
        tried += attempts(formulas(design, terms, place, seed), way)
    best = _best(tried)
    if best is None or best.refit.held_out > SETTINGS.law_complete:
        places = set(words)
        for way, law in single_terms(design, dependence, model, plays, part, every, nthread, seed):
            tried += attempts([law], way)
    best = _best(tried)
    if best is not None:
        tried = fewer_terms(tried, best, attempts)
        best = tried[-1]
    linear = dependence
    if first is None:
        if best is None or len(_near(tried, best)) > 1:  # two poses fit any two numbers
            return bare
        first = best.way
        dependence = with_first(dependence, first)
        bare = replace(bare, visit=visit(model, part.name, first, motions))
    table, band = _curve(design, positions, spans, first)
    bare = replace(bare, place=first.place, curve=table, curve_band=band)
    if not first.of_command and (best is None or best.refit.held_out > SETTINGS.law_complete):
        lib = with_curves(Library(model, part.base, (), part.rough), {(first.curve, first.place): spans[first.curve]})
        start = {
            f"{first.curve}.{first.place}.{n}": float(w) for n, w in zip(NAMES, (w for _, w in table), strict=True)
        }
        free = _refitted("curve", nothing, lib, plays, part, run, start, first, stated)
        if best is None or free.refit.held_out * SETTINGS.law_as_good < best.refit.held_out:
            best = free if np.isfinite(free.refit.held_out) else best
    bare = replace(bare, tried={_words(t, first): t.refit.held_out for t in tried})
    unconfirmed = replace(bare, depends=refuted(linear))
    if best is None:
        return unconfirmed
    base = best.search.refit([((), best.search.start)], LAW_ROUNDS, "fine")[0]
    before = hypothesis(best.search, base)
    if best.refit.held_out > SETTINGS.law_falls * before.cost:
        return unconfirmed
    text, law = "", best.law
    if best.kind == "formula":
        law = replace(law, terms=tuple(_refined(law.terms, best.refit.values)))
        mark = seen_mark(model, declared(effect_file(law.terms)), best.way.place, plays[0])
        text = effect_file(law.terms, mark)
        explained = explained_by(best.search, before, best.own)
        proposed = as_proposed(dependence, law, best.way, explained.share, explained.interval(seed))
        if proposed.first and proposed.first is not first:
            table, band = _curve(design, positions, spans, proposed.first)
            bare = replace(bare, curve=table, curve_band=band, visit=visit(model, part.name, proposed.first, motions))
        dependence = _decided(with_period(proposed, law, ratios(model.rig, part.name)), tried, best)
    return replace(
        bare, place=best.way.place, kind=best.kind, effect=best.effect, text=text,
        equation=equation_of(law.terms) if best.kind == "formula" else effects()[best.way.curve].equation,
        refit=best.refit, base_held_out=before.cost, model=best.model, depends=dependence, formula=law,
        ranked=_ranked(best, before, plays, sum(len(words[acts][1]) for acts in places), beside),
        left=missing_force(best.model, plays, part, nthread, passes=1),
    )  # fmt: skip


def _curve(
    design: Design, positions: Sequence[str], spans: Mapping[str, Mapping[str, float]], over: Dependence
) -> tuple[tuple[tuple[float, float], ...], tuple[float, ...]]:
    """What is missing over a variable, as (variable, force) at ten places, and half of the 90 % interval at each; none
    of a command that is late.
    """
    if over.late:
        return (), ()
    chosen = next(
        v
        for v in variables(design, positions)
        if (v.curve, v.place, v.signal == COMMAND) == (over.curve, over.place, over.of_command)
    )
    about = design.at(chosen.signal)
    columns = about.columns(chosen.rows, chosen.signal)
    weights = Predictor(about).explained(columns, curve=True).weights
    table = tuple(zip(knots_of(over.curve, spans[over.curve]).tolist(), weights.tolist(), strict=True))
    return table, tuple(half_widths(about, columns).tolist())


def _words(attempt: _Attempt, first: Dependence) -> str:
    """Its equation, and where it acts if that is elsewhere than what was named."""
    words, (place, what) = equation_of(attempt.law.terms), attempt.way.acts
    acts = {"sensor": "read by", "command": "in the command of", "force": "on"}[what]
    return words if (place, what) == first.acts else f"{words}, {acts} {place}"


def runs_away(model: Model, command: Command, nthread: int = 0) -> bool:
    """Whether a model diverges on a command, such as one that goes where the recordings did not.

    A force that grows with the angle may hold a joint where it was recorded, and drive it further away.
    """
    time, targets = command.sample(1.0 / model.rig.sample_time)
    return bool(simulate_batch(model, (), np.zeros((1, 0)), time, targets[None], nthread=nthread).failed.any())


def fewer_terms(
    tried: list[_Attempt], best: _Attempt, attempts: Callable[[Iterable[Formula], Dependence], list[_Attempt]]
) -> list[_Attempt]:
    """What was tried, and the best formula without each of its terms as long as one of these is as good; the best last.

    Terms were only added so far, and the first of them may have stood for a later one. The one without which most is
    left comes first: its variable is named.
    """
    while len(best.law.terms) > 1:
        terms = tuple(_refined(best.law.terms, best.refit.values))
        without = {i: attempts([replace(best.law, terms=terms[:i] + terms[i + 1 :])], best.way)
                   for i in range(len(terms))}  # fmt: skip
        tried = [*tried, *(each for some in without.values() for each in some)]
        simpler = _best(tried)
        if simpler is None or simpler is best:
            left = [without[i][0].refit.held_out if without[i] else math.inf for i in range(len(terms))]
            order = sorted(range(len(terms)), key=lambda i: -left[i])
            if order[0] != 0:
                tried = [t for t in tried if t is not best]
                (best,) = attempts([replace(best.law, terms=tuple(terms[i] for i in order))], best.way) or [best]
            break
        best = simpler
    return [*(t for t in tried if t is not best), best]


def _best(tried: Sequence[_Attempt]) -> _Attempt | None:
    """The formula that leaves least on left-out stretches; of those hardly worse, the one of fewest numbers.

    Where it acts is decided by smaller differences than how many terms it has, each of which must be material.
    """
    predicts = [t for t in tried if np.isfinite(t.refit.held_out)]  # NaN of one that diverges
    if not predicts:
        return None
    best = min(predicts, key=lambda t: t.refit.held_out)
    least = best.refit.held_out
    enough = {True: least + SETTINGS.material, False: 0.0}
    near = [t for t in predicts
            if t.refit.held_out <= max(SETTINGS.law_no_worse * least, enough[t.way.acts == best.way.acts])]  # fmt: skip
    return min(near, key=lambda t: (t.numbers, t.refit.held_out))


def _near(tried: Sequence[_Attempt], best: _Attempt) -> set[tuple[tuple[str, str], str]]:
    """Where formulas act, and what they are over, that do not leave clearly more in roll-outs than the best does."""
    return {t.over for t in tried if t.refit.held_out <= SETTINGS.law_as_good * best.refit.held_out}


def _ranked(
    best: _Attempt, before: Hypothesis, plays: Sequence[Play], terms: int, beside: AxisDiagnosis | None
) -> dict[str, float]:  # fmt: skip
    """Probabilities of the proposal, of none and unknown, and of the diagnosis's best sets if of the same samples."""
    search = best.search
    rivals: Sequence[Hypothesis] = ()
    drifts = False
    if beside is not None:
        drifts = any(r.drift for r in beside.odd)
        alike = beside.search.signal.shape == search.signal.shape and np.array_equal(beside.search.scale, search.scale)
        rivals = [h for h in beside.hypotheses if h.refit.effects] if alike else ()
    tried = terms + (len(beside.search.library.candidates) if beside else 0)
    whole = replace(before, left_out=before.refit.residuals)
    ranking = rank(whole, [*rivals, best.own], search.folds, search.blocks, tried, drifts=drifts,
                   floor=floor_known(plays), signals=search.signal)  # fmt: skip
    return ranking.probabilities


def _refined(terms: Sequence[Chosen], values: Mapping[str, float]) -> Iterator[Chosen]:
    """Terms with the numbers that roll-outs gave them."""
    short = {name.rpartition(".")[2]: value for name, value in values.items() if name.startswith(f"{NAME}.")}
    for chosen, prefix in zip(terms, prefixes(terms), strict=True):
        yield replace(chosen, values={n: short.get(f"{prefix}_{n}", v) for n, v in chosen.values.items()})


def _decided(dependence: Depends, tried: Sequence[_Attempt], best: _Attempt) -> Depends:
    """Without what acts elsewhere, or is over something else, and leaves clearly more in roll-outs."""
    near, judged = _near(tried, best), {t.over for t in tried if np.isfinite(t.refit.held_out)}
    worse = {acts for acts, _ in judged} - {acts for acts, _ in near}
    ties = (d for d in dependence.ties if d.acts not in worse and (d.acts, d.over) not in judged - near)
    return replace(dependence, ties=tuple(ties))


def confirmed(proposal: Proposal, plays: Sequence[Play], nthread: int = 0) -> Proposal:
    """A proposal tested on plays of another command; nothing is fitted to them."""
    if proposal.base is None or proposal.model is None:
        return proposal
    before, after = (floors_on(m, plays, proposal.axis, nthread) for m in (proposal.base, proposal.model))
    return replace(proposal, confirmation=Confirmation(before, after))


def proposal_of(diagnosis: Diagnosis, plays: Sequence[Play], nthread: int = 0, seed: int = 0) -> Proposal | None:
    """What is proposed for the axis that lacks most, if the verdict is "unknown"; None otherwise.

    It includes the missing force of every other axis that leaves more than noise, and of the load's side of elastic
    axes.
    """
    floors = {name: a.worst(name) for a in diagnosis.axes for name in a.part.axes if name != BALL}
    most = max(floors, key=lambda name: floors[name])
    if diagnosis.verdict.verdict != "unknown" or floors[most] <= SETTINGS.healthy:
        return None
    model, alone = diagnosis.base_model, [without_ball(p) for p in plays]
    parts = {p.name: p for p in axis_parts(model, alone)}
    beside = next(a for a in diagnosis.axes if most in a.part.axes)
    proposal = propose(model, alone, parts[most], nthread, seed, beside)
    return replace(proposal, also=also_missing(model, alone, parts, most, floors, nthread))


def also_missing(
    model: Model, plays: Sequence[Play], parts: Mapping[str, AxisPart], most: str, left: Mapping[str, float],
    nthread: int = 0,
) -> tuple[MissingForce, ...]:  # fmt: skip
    """Missing forces on other axes than one, and on the load's side of any.

    Args:
        parts: axis -> what is compared of it.
        most: that axis.
        left: axis -> floors that the model leaves on it.
    """
    forces = []
    for name, part in parts.items():
        if left.get(name, 0.0) <= SETTINGS.healthy:
            continue
        sides = ([False] if name != most else []) + ([True] if model.rig.axis(name).belt else [])
        forces += [missing_force(model, plays, part, nthread, at_load=side) for side in sides]
    return tuple(forces)


def ratios(rig: Rig, axis: str) -> dict[str, float]:
    """What turns with an axis's driven joint -> its turns for one of the joint, from the rig file."""
    own = rig.axis(axis)
    return {} if own.slides else {"joint": 1.0, **own.turns}


def _formula_refitted(
    law: Formula, way: Dependence, model: Model, plays: Sequence[Play], part: AxisPart, run: SearchOptions,
    stated: Mapping[str, float],
) -> _Attempt:  # fmt: skip
    """A formula in roll-outs, from the numbers that it has."""
    lib = library_of(model, part, [(declared(effect_file(law.terms)), way.place)])
    named = zip(law.terms, prefixes(law.terms), strict=True)
    start = {f"{NAME}.{way.place}.{name}_{n}": v for c, name in named for n, v in c.values.items()}
    return _refitted("formula", law, lib, plays, part, run, start, way, stated)


def _refitted(
    kind: str, law: Formula, lib: Library, plays: Sequence[Play], part: AxisPart, run: SearchOptions,
    start: Mapping[str, float], way: Dependence, stated: Mapping[str, float],
) -> _Attempt:  # fmt: skip
    """A library's one candidate in roll-outs, from start values.

    Args:
        stated: base values that it is started from as well: those of the model were fitted without what is missing, and
            may lie in a valley where a law leaves more than it has to.
    """
    search = search_of(lib, plays, part, run)
    own = lib.candidates[0]

    def begun(numbers: Mapping[str, float]) -> Array:
        given = [numbers.get(name, value) for name, value in zip(lib.names, search.start, strict=True)]
        return search.within(np.array(given))

    points = np.unique([begun(start), begun({**stated, **start})], axis=0)
    refit = lowest(search.refit([((own,), values) for values in points], LAW_ROUNDS, "fine"))
    columns = search.fitted(refit)
    slopes = search.jacobian(refit)
    spread = max(refit.cost, 1.0) * SETTINGS.correlated
    covariance = np.linalg.pinv(slopes.T @ slopes) * spread
    half = 1.645 * np.sqrt(np.maximum(np.diag(covariance), 0.0)) * search.spans[columns]
    fitted = {lib.names[c]: float(refit.values[c]) for c in columns}
    intervals = {lib.names[c]: float(h) for c, h in zip(columns, half, strict=True)}
    known = lib.model.parameters()
    judged = hypothesis(search, refit)
    refitted = Refitted(fitted, intervals, {name: known[name].unit for name in fitted}, refit.cost, judged.cost)
    return _Attempt(kind, way, own.name, law, refitted, _with(lib.model, own, part, fitted), judged, search)


def _with(model: Model, own: Candidate, part: AxisPart, fitted: Mapping[str, float]) -> Model:
    return model.with_values({n: v for n, v in fitted.items() if n in (*own.parameters, *part.base)}, "proposed")
