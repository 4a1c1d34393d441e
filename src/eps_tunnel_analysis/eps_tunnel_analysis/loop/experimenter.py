# SPDX-License-Identifier: Apache-2.0
"""Plays, compares, diagnoses, plays the deciding experiment, adds effects, and repeats until nothing more can be named.

Exploration and estimation alternate, after Bongard and Lipson (IEEE Trans. Evolutionary Computation 9, 2005). On
recordings alone it does the same without playing.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from eps_tunnel_analysis.diagnose.addition import Addition, addition_of
from eps_tunnel_analysis.diagnose.progress import RolloutProgress
from eps_tunnel_analysis.diagnose.rank import IMITATED, NAMELESS, NONE, UNKNOWN, itself
from eps_tunnel_analysis.diagnose.verdict import Errors, Verdict, in_words
from eps_tunnel_analysis.law.proposal import Proposal, confirmed
from eps_tunnel_analysis.loop.gap import Bags, Gap, PlayableRig, measure_gap, write_gap
from eps_tunnel_analysis.loop.reason import DiagnosisOptions, DiagnosisRun, Reason, diagnose_bags
from eps_tunnel_analysis.outputs import json_text, plain
from eps_tunnel_analysis.report.reports import model_provenance
from labyrinth_sim.model import Model, load_model, save_model
from labyrinth_sim.registry import Registry
from labyrinth_sim.whole_file import write_new

STEP_LIMIT = "step limit"
LIKELY = 0.5  # probability above which an effect that is not certain is added


@dataclass(frozen=True)
class Plan:
    """What is to be done.

    Attributes:
        model, sequence: names or paths to start from.
        trials: of each play.
        most_steps: largest number of additions.
        most_experiments: largest number played for one decision.
        search: how recordings are read and diagnosed.
        recordings: bags of the real side to work on; none if a rig plays.
        replay: if nothing can be added, load the refitted values into the simulation and play once more.
        propose: if no known effect explains the error, look for a law, and play another command to confirm it.
    """

    model: str
    sequence: str = "excite_12s"
    trials: int = 3
    most_steps: int = 5
    most_experiments: int = 3
    search: DiagnosisOptions = field(default_factory=DiagnosisOptions)
    recordings: tuple[Path, ...] = ()
    replay: bool = False
    propose: bool = True


@dataclass(frozen=True)
class Stair:
    """One step of the staircase of error: what the model has, and how far it is from the rig.

    Attributes:
        step: "as given", "refitted values", or "+" and what was added.
        error: equation 10, mean over signals, in the rig's `position_unit`.
        alikeness: joint, at k = 1.
        held_out: the error on held-out data; NaN if it is that of a fresh play.
        repeats: the rig's own repeat error; NaN if it was not measured.
        itself: alikeness that the rig reaches against itself, joint, at k = 1; NaN if it was not measured.
        ball: its errors, m, if it was seen.
    """

    step: str
    added: tuple[str, ...] = ()
    error: float = math.nan
    alikeness: float = math.nan
    held_out: float = math.nan
    repeats: float = math.nan
    itself: float = math.nan
    ball: Errors | None = None


@dataclass(frozen=True)
class Played:
    """A sequence was played on both sides and recorded: with which model and why; the gap's report."""

    sequence: str
    trials: int
    why: str
    bags: Bags
    gap: Gap
    report: Path


@dataclass(frozen=True)
class Added:
    """The model was changed, and the simulation, if there is one, runs it.

    Attributes:
        words: the effects, in words; "" where the values were only refitted.
        why: they were added although the diagnosis names no single set; "" if it names them.
        file: of the new model.
    """

    addition: Addition
    words: str
    why: str
    file: Path


@dataclass(frozen=True)
class Tested:
    """A proposed law, tested on a play of another command; `reason` proposed it."""

    proposal: Proposal
    reason: Reason


@dataclass(frozen=True)
class Ending:
    """Nothing more is done.

    Attributes:
        verdict: complete, unknown, undecided, or "step limit".
        effects: all that were added.
        stated: the hypotheses that the last diagnosis leaves.
        sentence: in words.
        model: file of the last model.
        steps: the staircase of error.
        last: the last diagnosis.
        proposal: the law that is proposed if no known effect explains the error.
    """

    verdict: str
    sentence: str
    effects: tuple[str, ...]
    stated: tuple[str, ...]
    model: Path
    steps: tuple[Stair, ...]
    last: Reason
    proposal: Proposal | None = None

    def to_json(self) -> dict[str, Any]:
        """staircase.json"""
        words: dict[str, Any] = {"verdict": self.verdict, "sentence": self.sentence, "model": str(self.model)}
        if self.proposal:
            words |= {"proposed_effect": plain(self.proposal.to_json()), "proposed_in": str(self.last.folder)}
        return words | {"effects": self.effects, "stated": self.stated, "steps": [asdict(s) for s in self.steps]}


Step = Played | Reason | Added | Tested | Ending


def heading(step: Step) -> str:
    """A step in one line."""
    match step:
        case Played():
            return f"Played {step.sequence}, {step.trials} trials, with {step.why}"
        case Reason():
            return f"Diagnosis: {step.diagnosis.verdict.verdict}"
        case Added():
            return f"Added {step.words}" if step.words else "Refitted the model's values"
        case Tested():
            c = step.proposal.confirmation
            return f"Proposed law: {'confirmed' if c and c.holds else 'not confirmed'}"
        case Ending():
            return f"The end: {step.verdict}"


def chosen_effects(verdict: Verdict, registry: Registry) -> tuple[tuple[str, ...], str]:
    """The effects to add, and why if it is not the verdict itself; none if nothing should be added.

    For an undecided verdict: what all stated sets share; if they share nothing, the simplest of them, because a set
    that no recording at hand can distinguish from another does no harm. Nothing if "nothing missing" is one of them.
    """
    if verdict.verdict == "effect":
        return verdict.effects, ""
    sets = [name for name in verdict.stated if name not in NAMELESS]
    if verdict.verdict != "undecided" or NONE in verdict.stated or not sets:
        return (), ""
    marginals = {name: p for axis in verdict.axes.values() for name, p in axis.marginals.items()}
    named = [name.split(" + ") for name in sets]
    shared = [n for n in named[0] if all(n in other for other in named) and marginals.get(n, 0.0) > itself(LIKELY)]
    if shared:
        words = " and ".join(in_words(name, registry) for name in shared)
        if len(sets) == 1:
            return tuple(shared), f"More likely than not, {words} is missing; something unknown may be missing as well."
        return tuple(shared), f"These recordings leave {len(sets)} sets of effects; all of them contain {words}."
    if sum(verdict.set[name] for name in sets) + verdict.set.get(IMITATED, 0.0) <= LIKELY:
        return (), ""

    def size(name: str) -> tuple[int, int, float]:
        effects = name.split(" + ")
        return len(effects), sum(_values(e, registry) for e in effects), -verdict.set[name]

    simplest = min(sets, key=size)
    others = " or ".join(" with ".join(in_words(e, registry) for e in s.split(" + ")) for s in sets if s != simplest)
    return tuple(simplest.split(" + ")), f"No recording at hand distinguishes it from {others}; it is the simplest."


def _values(name: str, registry: Registry) -> int:
    """How many values an effect needs; one that is kept as stated unless the effect is missing is a refinement."""
    return sum(not p.settled for p in registry.effect(name.partition(".")[0]).parameters)


@dataclass
class Experimenter:
    """One run of the loop.

    Args:
        folder: exists; receives bags, gaps, diagnoses, models, and staircase.json.
        rig: to play on; None if the plan names recordings.
        progress: a context whose value is called while a diagnosis makes roll-outs.
    """

    plan: Plan
    folder: Path
    rig: PlayableRig | None = None
    progress: Callable[[], AbstractContextManager[RolloutProgress | None]] = nullcontext
    _played: list[tuple[Bags, Gap]] = field(default_factory=list)
    _plays: int = 0
    _diagnoses: int = 0
    _repeated: bool = False
    _experiments: list[str] = field(default_factory=list)
    _stairs: list[Stair] = field(default_factory=list)
    _added: list[str] = field(default_factory=list)
    _additions: int = 0
    _proposal: Proposal | None = None

    def steps(self) -> Iterator[Step]:
        """Each step when it is over; the last one is an Ending.

        Raises:
            InputError, RigFailed, KeyboardInterrupt: what ended it early; everything done so far is on disk.
        """
        plan = self.plan
        model, path = load_model(plan.model, plan.search.effects), plan.model
        if self.rig:
            yield self._play(plan.sequence, model, f"the model as given, {model.name}", Stair("as given"))
        levels: dict[str, float] = {}
        while True:
            reason = self._diagnose(path, levels)
            yield reason
            verdict = reason.diagnosis.verdict
            levels = levels or {axis: before for axis, (before, _) in verdict.floor.items()}
            if not self._stairs:
                self._stairs += [_stair("as given", (), verdict.given, verdict.ball[:1], verdict),
                                 _stair("refitted values", (), verdict.before, verdict.ball[1:2], verdict)]  # fmt: skip
            again = self._experiment(reason, model) or self._repeat(reason, model)
            if again:
                yield again
                continue
            if (law := self._visited(reason, model)) is not None:
                yield law
            if (tested := self._tested(reason, law)) is not None:
                yield tested
            self._experiments.clear()
            addition, why = self._addition(reason)
            limited = bool(addition.effects) and self._additions >= plan.most_steps
            if limited:
                addition = addition_of(reason.diagnosis, (), reason.recorded.plays, reason.recorded.held)
            self._additions += 1
            model, file = self._save(addition, reason)
            if self.rig:
                self.rig.load(file)
            words = " and ".join(in_words(name, model.registry) for name in addition.effects)
            if words or (plan.replay and self.rig):
                yield Added(addition, words, why, file)
                name = "+ " + ", ".join(addition.effects) if words else "refitted values"
                if self.rig:
                    doing = f"the model with {words or 'refitted values'}"
                    yield self._play(plan.sequence, model, doing, Stair(name, addition.effects))
                else:
                    ball = verdict.ball[2:] if set(addition.effects) == set(verdict.effects) else ()
                    self._stairs.append(_stair(name, addition.effects, addition.after, ball, verdict))
            if not words:
                yield self._ending(STEP_LIMIT if limited else verdict.verdict, reason, file)
                return
            self._added += addition.effects
            path = str(file)

    def _play(self, sequence: str, model: Model, why: str, stair: Stair | None = None) -> Played:
        """Plays on both sides and records the gap, as a step of the staircase if one is given."""
        assert self.rig is not None
        self._plays += 1
        bags = self.rig.play(sequence, self.plan.trials, self.folder / f"play_{self._plays}")
        gap = measure_gap(bags, model.rig)
        self._played.append((bags, gap))
        page = self.folder / f"gap_{self._plays}"
        write_gap(gap, bags, page, model.name, str(model.path or model.name))
        if stair:
            alike = gap.alikeness[min(gap.alikeness)]
            measured = replace(stair, error=gap.error, alikeness=alike, repeats=gap.repeats, itself=gap.itself)
            self._stairs.append(measured)
        return Played(Path(sequence).stem, self.plan.trials, why, bags, gap, page / "report.html")

    def _diagnose(self, model: str, levels: dict[str, float]) -> Reason:
        self._diagnoses += 1
        folder = self.folder / f"{'diagnosis' if self.rig else 'step'}_{self._diagnoses}"
        real = [bag for bags, _ in self._played for bag in bags.real] or self.plan.recordings
        limit = self.rig.limit() if self.rig else None
        propose = self.plan.propose and not self._uneven()
        with self.progress() as progress:
            run = DiagnosisRun(progress, limit, levels or None, propose)
            reason = diagnose_bags(model, real, folder, self.plan.search, run)
        if self.rig:
            self.rig.publish(reason.content, reason.report)
        return reason

    def _experiment(self, reason: Reason, model: Model) -> Played | None:
        """Plays the deciding experiment; None if nothing is undecided, or there is nothing new to play."""
        experiment, tried = reason.diagnosis.experiment, self._experiments
        if not self.rig or reason.diagnosis.verdict.verdict != "undecided" or experiment is None:
            return None
        if len(tried) >= self.plan.most_experiments or experiment.name in tried:
            return None
        tried.append(experiment.name)
        file = self.folder / f"{experiment.name}.yaml"
        if not file.exists():
            write_new(file, experiment.to_yaml(self.plan.trials))
        return self._play(str(file), model, f"the same model, to decide. {experiment.reason}")

    def _repeat(self, reason: Reason, model: Model) -> Played | None:
        """Plays again what was timed unevenly, because no effect explains that; None if nothing was.

        Only once: if the rig is always uneven, the verdict remains "unknown".
        """
        uneven = self._uneven()
        if reason.diagnosis.verdict.verdict != "unknown" or not uneven or self._repeated:
            return None
        self._repeated = True
        self._played = [(bags, gap) for bags, gap in self._played if all(gap is not other for other in uneven)]
        late = max(gap.jitter for gap in uneven)
        why = f"the same model, because trials differed as if they had come {1e3 * late:.0f} ms early or late"
        return self._play(self.plan.sequence, model, why, self._stairs.pop())

    def _uneven(self) -> list[Gap]:
        """Gaps of plays whose trials were timed more unevenly than is known of the rig."""
        return [gap for _, gap in self._played if gap.jitter > self.plan.search.timing]

    def _visited(self, reason: Reason, model: Model) -> Played | None:
        """Plays the command that shows a proposed law best; None if none is proposed, or there is no rig."""
        proposal = reason.proposal
        if not self.rig or proposal is None or proposal.model is None or proposal.visit is None:
            return None
        file = reason.folder / f"{proposal.visit.name}.yaml"
        return self._play(str(file), model, f"the same model, to confirm the proposed law. {proposal.visit.reason}")

    def _tested(self, reason: Reason, played: Played | None) -> Tested | None:
        """The result of a proposed law on a play of another command, or on held-out recordings."""
        if reason.proposal is None:
            return None
        options, plays = self.plan.search, reason.recorded.held
        if played:
            plays = options.recorded(self.plan.model, played.bags.real).plays
        self._proposal = confirmed(reason.proposal, plays, options.threads) if plays else reason.proposal
        return Tested(self._proposal, reason) if self._proposal.confirmation else None

    def _addition(self, reason: Reason) -> tuple[Addition, str]:
        """The model with the effects to add, and why they are not the verdict itself; with refitted values if nothing
        should be added, or if it does not help on held-out data."""
        diagnosis, recorded = reason.diagnosis, reason.recorded
        names, why = chosen_effects(diagnosis.verdict, diagnosis.model.registry)
        addition = addition_of(diagnosis, names, recorded.plays, recorded.held)
        if why and addition.after.held_out >= addition.before.held_out:
            return addition_of(diagnosis, (), recorded.plays, recorded.held), ""
        return addition, why

    def _save(self, addition: Addition, reason: Reason) -> tuple[Model, Path]:
        name = f"model_{self._additions}"
        provenance = model_provenance(reason.recorded, addition.effects, addition.errors)
        model = replace(addition.model, name=name, rig=reason.recorded.model.rig, provenance=provenance)
        return model, save_model(model, self.folder / f"{name}.yaml")

    def _ending(self, verdict: str, reason: Reason, model: Path) -> Ending:
        v, most = reason.diagnosis.verdict, self.plan.most_steps
        sentence = v.sentence + (f" It is not added: {most} steps were allowed." if verdict == STEP_LIMIT else "")
        law = self._proposal
        sentence += f" {law.sentence}" if law else ""
        ending = Ending(verdict, sentence, tuple(self._added), v.stated, model, tuple(self._stairs), reason, law)
        write_new(self.folder / "staircase.json", json_text(ending.to_json()))
        return ending


def _stair(name: str, added: tuple[str, ...], errors: Errors, ball: tuple[Errors, ...], of: Verdict) -> Stair:
    return Stair(
        name, added, errors.error, errors.alikeness, errors.held_out, itself=of.rig_against_itself,
        ball=ball[0] if ball else None,
    )  # fmt: skip


def truth(hidden: Sequence[Mapping[str, Any]]) -> str:
    """The true hypothesis, named as in a verdict's set; `hidden` as the testbed's --reveal writes it."""
    if not hidden:
        return NONE
    if not all(item["known"] for item in hidden):
        return UNKNOWN
    places = {item["effect"]: ("x", "y") if item["axis"] == "both" else (item["axis"],) for item in hidden}
    return " + ".join(sorted(f"{effect}.{place}" for effect, found in places.items() for place in found))


def judged(
    hidden: Sequence[Mapping[str, Any]], effects: Sequence[str], ending: str, stated: Sequence[str], registry: Registry
) -> str:
    """Whether the hidden effect was found.

    Args:
        effects: every effect that was named.
        ending: the last verdict: complete, effect, undecided or unknown.
        stated: the hypotheses that the last verdict leaves.
        registry: has the effects' titles.
    """
    true = truth(hidden)
    said = " + ".join(sorted(effects)) or {"unknown": UNKNOWN, "complete": NONE}.get(ending, "")
    if said == true and ending != "undecided":
        return "Right." if effects else f"Right: the verdict was '{ending}'."
    hid = set(true.split(" + "))
    if hid <= set(effects):
        more = " and ".join(in_words(name, registry) for name in sorted(set(effects) - hid))
        return f"It was found; also named: {more}." if more else "It was found; it is not decided whether that is all."
    if ending == "undecided" and true in stated:
        return f"It is one of the {len(stated)} hypotheses that these recordings leave."
    naming = [set(name.split(" + ")) for name in stated if name not in NAMELESS]
    if ending == "undecided" and naming and all(hid <= names for names in naming):
        return "It was found; it is not decided whether that is all."
    return "That was not found."
