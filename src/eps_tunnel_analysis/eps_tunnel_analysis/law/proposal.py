# SPDX-License-Identifier: Apache-2.0
"""What is proposed where no effect of the library explains what is missing: an effect file with a formula, or a curve.

Both are refitted in whole roll-outs together with the base values, and judged on stretches of time that were left out.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from eps_tunnel_analysis.diagnose.axes import Diagnosis
from eps_tunnel_analysis.diagnose.axis import hypothesis
from eps_tunnel_analysis.diagnose.axis_search import AxisPart, SearchOptions, axis_parts, moved_parts, search_of
from eps_tunnel_analysis.diagnose.ball import BALL, without_ball
from eps_tunnel_analysis.diagnose.candidates import Candidate, Library, candidate, with_curves
from eps_tunnel_analysis.diagnose.settings import SETTINGS
from eps_tunnel_analysis.law.added_force import visited
from eps_tunnel_analysis.law.depends import Depends, Design, Predictor, depends, knots_of, traced, variables
from eps_tunnel_analysis.law.effect_file import NAME, declared, effect_file, prefixes, seen_mark
from eps_tunnel_analysis.law.formula import Chosen, Formula, dictionary, formula, sensor_dictionary
from eps_tunnel_analysis.law.missing_force import MissingForce, missing_force
from eps_tunnel_analysis.law.refit import floors_on, quick_bases, thorough_bases, worst_on
from eps_tunnel_analysis.law.visit import Visit, visit
from eps_tunnel_analysis.outputs import shown_number, shown_value
from eps_tunnel_analysis.simulated import Play
from labyrinth_sim.curve import NAMES
from labyrinth_sim.effect import Effect, effects
from labyrinth_sim.model import Model, save_model
from labyrinth_sim.rig import Rig
from labyrinth_sim.shown import shown

ROUNDS = 6
ENOUGH = 2.0  # floors where left out: a formula that leaves no more needs no curve beside it
AS_GOOD = 1.2  # times the floors that the curve leaves where left out: a formula that leaves no more is preferred
FALLS = 0.7  # of the base's floors where left out; what leaves more is not proposed
CONFIRMED = 0.5  # of what a model leaves of another command beyond noise: a law that holds takes away as much


@dataclass(frozen=True)
class Refitted:
    """A proposal in roll-outs.

    Attributes:
        values: full parameter name -> fitted number.
        intervals: the same -> half of its 90 % interval.
        floors: left of all samples; `held_out`: of stretches of time that were left out.
    """

    values: Mapping[str, float]
    intervals: Mapping[str, float]
    floors: float
    held_out: float


@shown
@dataclass(frozen=True)
class Confirmation:
    """What another command says of a proposal: mean square in units of the noise floor, without it and with it."""

    before: float
    after: float

    @property
    def holds(self) -> bool:
        """Whether it takes away half of what is to be explained."""
        return self.after <= self.before - CONFIRMED * (self.before - min(self.before, 1.0)) < self.before

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
        kind: "formula", "curve", or "" where nothing is proposed.
        effect: the effect's full name with its place.
        text: of the file that declares it; "" for a curve, which the library has.
        equation: for people.
        refit: in roll-outs; None where nothing is proposed.
        base_held_out: floors that the model leaves without it where left out.
        base: the model without it, refitted; `model` with the proposal added and fitted.
        curve: what is missing over the variable named, as (variable, force) at ten places, without any formula.
        visit: the command that shows it best, where something is named.
        confirmation: what another command says of it; None until one was played.
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

    @property
    def position_unit(self) -> str:
        """SI unit of the axis's position."""
        return "m" if self.missing.unit == "N" else "rad"

    @property
    def sentence(self) -> str:
        """What is found, in words."""
        first = self.depends.first
        if first is None:
            text = f"Axis {self.axis}: what is missing depends on none of the variables more than chance allows."
            return text + (f" {self.visit.name}.yaml would tell more." if self.visit else "")
        waves = f", with a period of {shown_value(first.period, self.position_unit, 4)}" if first.period else ""
        waves += f", which is {first.traced}" if first.traced else ""
        low, high = first.interval
        text = (
            f"Axis {self.axis}: what is missing depends on {self.depends.words}{waves}; that predicts "
            f"{first.share:.0%} ({low:.0%} to {high:.0%}) of it where it was left out, chance "
            f"{max(self.chance, 0.0):.0%}."
        )
        if self.refit:
            form = f"{self.equation}" if self.kind == "formula" else "a free curve"
            text += (
                f" Proposed is {form}: {shown_number(self.refit.held_out, 2)} floors are left where left out, against "
                f"{shown_number(self.base_held_out)}. "
            )
            text += self.confirmation.sentence if self.confirmation else "Found in these data, not confirmed."
        if self.depends.ties and self.visit:
            text += f" These recordings do not tell {self.depends.words}; {self.visit.name}.yaml may."
        return text

    @property
    def chance(self) -> float:
        """Share that a variable moved in time explains by chance, at most."""
        return self.depends.chance

    def write(self, folder: Path) -> None:
        """Writes what is proposed: the effect's file where it is a formula, and the model with it."""
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
            "floors": list(self.missing.floors),
            "depends_on": [asdict(d) for d in self.depends.dependences],
            "terms": [{"term": c.term.equation, **c.values} for c in self.formula.terms],
            "refit": refit,
            "base_held_out": self.base_held_out if self.refit else None,
        }


def propose(model: Model, plays: Sequence[Play], part: AxisPart, nthread: int = 0, seed: int = 0) -> Proposal:
    """What one axis lacks, if no effect of the library is it.

    Args:
        model: with its values refitted.
        plays: recorded.
        part: of the axis.
    """
    missing = missing_force(model, plays, part, nthread)
    if missing.worst <= SETTINGS.healthy:
        return Proposal(part.name, part.name, missing, Depends((), 0.0), Formula((), 0.0, (0.0, 0.0)))
    design = Design.of(missing)
    positions = [m.signal for m in model.rig.measured if m.quantity == "position" and m.signal in part.signals]
    found = depends(design, positions, seed, ratios(model.rig, part.name))
    first, motions = found.first, [p.motion for p in design.plays]
    shows = visit(model, part.name, first or found.dependences[0], motions)
    if first is None:
        return Proposal(part.name, part.name, missing, found, Formula((), 0.0, (0.0, 0.0)), base=model, visit=shows)
    sensor = list(part.signals).index(first.place) if first.curve == "curve_sensor" else None
    law = formula(design, dictionary(design) if sensor is None else sensor_dictionary(design), sensor, seed)
    spans = visited(motions)
    spans["curve_sensor"] = spans["curve_angle"]
    chosen = next(v for v in variables(design, positions) if (v.curve, v.place) == (first.curve, first.place))
    weights = Predictor(design).explained(chosen.columns(design), curve=True).weights
    table = tuple(zip(knots_of(first.curve, spans[first.curve]).tolist(), weights.tolist(), strict=True))
    bare = Proposal(part.name, first.place, missing, found, law, base=model, curve=table, visit=shows)
    run = SearchOptions((), nthread)
    tried: list[tuple[str, str, Refitted, Model, float]] = []
    text = ""
    if law.terms:
        text = effect_file(law.terms, sensor is not None)
        effect = declared(text)
        lib = _library(model, part, effect, first.place)
        named = zip(law.terms, prefixes(law.terms), strict=True)
        start = {f"{NAME}.{first.place}.{name}_{n}": v for c, name in named for n, v in c.values.items()}
        tried.append(("formula", f"{NAME}.{first.place}", *_refitted(lib, plays, part, run, start)))
    if not tried or not tried[0][2].held_out <= ENOUGH:  # NaN of one that diverges
        lib = with_curves(Library(model, part.base, (), part.rough), {(first.curve, first.place): spans[first.curve]})
        start = {f"{first.curve}.{first.place}.{n}": float(w) for n, w in zip(NAMES, weights, strict=True)}
        tried.append(("curve", f"{first.curve}.{first.place}", *_refitted(lib, plays, part, run, start)))
    predicts = [t for t in tried if np.isfinite(t[2].held_out)]
    if not predicts:
        return bare
    kind, name, refit, final, before = min(
        predicts, key=lambda t: t[2].held_out * (1.0 if t[0] == "formula" else AS_GOOD)
    )
    if refit.held_out > FALLS * before:
        return bare
    form = " + ".join(c.term.equation for c in law.terms)
    if kind == "formula":
        law = replace(law, terms=tuple(_refined(law.terms, refit.values)))
        mark = seen_mark(model, declared(effect_file(law.terms, sensor is not None)), first.place, plays[0])
        text = effect_file(law.terms, sensor is not None, mark)
        found = _with_period(found, law, ratios(model.rig, part.name))
    return replace(
        bare, kind=kind, effect=name, text=text if kind == "formula" else "",
        equation=form if kind == "formula" else effects()[first.curve].equation,
        refit=refit, base_held_out=before, model=final, depends=found, formula=law,
    )  # fmt: skip


def _refined(terms: Sequence[Chosen], values: Mapping[str, float]) -> Iterator[Chosen]:
    """Terms with the numbers that roll-outs gave them."""
    short = {name.rpartition(".")[2]: value for name, value in values.items() if name.startswith(f"{NAME}.")}
    for chosen, prefix in zip(terms, prefixes(terms), strict=True):
        yield replace(chosen, values={n: short.get(f"{prefix}_{n}", v) for n, v in chosen.values.items()})


def _with_period(found: Depends, law: Formula, turns: Mapping[str, float]) -> Depends:
    """What is named, with the period that the formula has of it."""
    first = found.first
    acts = {"curve_angle": "torque", "curve_angle_friction": "friction", "curve_sensor": "sensor"}
    waves = [c.values for c in law.terms if "period" in c.values and first and c.term.acts == acts.get(first.curve)]
    if first is None or not waves:
        return found
    period = abs(max(waves, key=lambda values: abs(values["size"]))["period"])
    named = replace(first, period=period, traced=traced(period, turns))
    every = tuple(named if d is first else d for d in found.dependences)
    return replace(found, dependences=every, first=named)


def confirmed(proposal: Proposal, plays: Sequence[Play], nthread: int = 0) -> Proposal:
    """A proposal with what plays of another command say of it; nothing is fitted to them."""
    if proposal.base is None or proposal.model is None:
        return proposal
    before, after = (floors_on(m, plays, proposal.axis, nthread) for m in (proposal.base, proposal.model))
    return replace(proposal, confirmation=Confirmation(before, after))


def proposal_of(diagnosis: Diagnosis, plays: Sequence[Play], nthread: int = 0, seed: int = 0) -> Proposal | None:
    """What is proposed for the axis that lacks most, where the verdict is "unknown"; None elsewhere."""
    left = {name: a.worst(name) for a in diagnosis.axes for name in a.part.axes if name != BALL}
    most = max(left, key=lambda name: left[name])
    if diagnosis.verdict.verdict != "unknown" or left[most] <= SETTINGS.healthy:
        return None
    alone = [without_ball(p) for p in plays]
    part = next(p for p in axis_parts(diagnosis.base_model, alone) if p.name == most)
    return propose(diagnosis.base_model, alone, part, nthread, seed)


def propose_on(
    model: Model, plays: Sequence[Play], nthread: int = 0, seed: int = 0, thorough: bool = False
) -> tuple[Model, list[Proposal]]:
    """The model with its base values refitted, and what is proposed for each axis that leaves more than noise.

    Without the search for an effect of the library, which is the diagnosis's.

    Args:
        thorough: refit base values as a diagnosis does, from many starts.
    """
    alone = [without_ball(p) for p in plays]
    parts = moved_parts(model, axis_parts(model, alone), alone)
    base = (thorough_bases if thorough else quick_bases)(model, alone, parts, nthread)
    wanting = [part for part in parts if worst_on(base, alone, part, nthread) > SETTINGS.healthy]
    return base, [propose(base, alone, part, nthread, seed) for part in wanting]


def ratios(rig: Rig, axis: str) -> dict[str, float]:
    """What turns with an axis's driven joint -> its turns for one of the joint, as the rig file states them."""
    own = rig.axis(axis)
    return {} if own.slides else {"joint": 1.0, **own.turns}


def _library(model: Model, part: AxisPart, effect: Effect, place: str) -> Library:
    off = model.with_effect(effect, place, effect.off, "switched off")
    return Library(off, part.base, (candidate(off, effect, place),), part.rough)


def _refitted(
    lib: Library, plays: Sequence[Play], part: AxisPart, run: SearchOptions, start: Mapping[str, float]
) -> tuple[Refitted, Model, float]:
    """A library's one candidate in roll-outs, from start values; the model with it; the base's floors, left out."""
    search = search_of(lib, plays, part, run)
    own = lib.candidates[0]
    values = search.start.copy()
    for name, number in start.items():
        column = lib.names.index(name) if name in lib.names else -1
        if column >= 0:
            values[column] = np.clip(number, search.low[column], search.high[column])
    base = search.refit([((), search.start)], ROUNDS, "fine")[0]
    refit = search.refit([((own,), values)], ROUNDS, "fine")[0]
    columns = search.fitted(refit)
    slopes = search.jacobian(refit)
    span = (search.high - search.low)[columns]
    spread = max(refit.cost, 1.0) * SETTINGS.correlated
    covariance = np.linalg.pinv(slopes.T @ slopes) * spread
    half = 1.645 * np.sqrt(np.maximum(np.diag(covariance), 0.0)) * span
    fitted = {lib.names[c]: float(refit.values[c]) for c in columns}
    intervals = {lib.names[c]: float(h) for c, h in zip(columns, half, strict=True)}
    model = _with(lib.model, own, part, fitted)
    found = Refitted(fitted, intervals, refit.cost, hypothesis(search, refit).cost)
    return found, model, hypothesis(search, base).cost


def _with(model: Model, own: Candidate, part: AxisPart, fitted: Mapping[str, float]) -> Model:
    return model.with_values({n: v for n, v in fitted.items() if n in (*own.parameters, *part.base)}, "proposed")
