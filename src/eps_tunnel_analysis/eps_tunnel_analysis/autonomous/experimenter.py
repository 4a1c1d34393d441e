# SPDX-License-Identifier: Apache-2.0
"""Plays, compares, diagnoses, plays what decides, adds, and plays again, until nothing more can be named.

Exploration and estimation in turn, after Bongard and Lipson (IEEE Trans. Evolutionary Computation 9, 2005).
"""

import json
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass, field, replace
from pathlib import Path

from eps_tunnel_analysis.autonomous.gap import Gap, measure_gap, write_gap
from eps_tunnel_analysis.autonomous.notebook import Notebook
from eps_tunnel_analysis.autonomous.pages import diagnosis_page, ending_page, gap_page, values_page
from eps_tunnel_analysis.autonomous.reason import Reason, Search, find_reason
from eps_tunnel_analysis.autonomous.rig import Bags, Rig, RigFailed
from eps_tunnel_analysis.diagnose.verdict import in_words
from labyrinth_sim.model import Model, load_model, save_model

Told = Callable[[str, int], None]
STEP_LIMIT = "step limit"


@dataclass(frozen=True)
class Plan:
    """What is to be done.

    Attributes:
        model, sequence: names or paths to start from.
        trials: of each play.
        most_steps: so often effects are added at most.
        most_experiments: so many are played for one decision at most.
    """

    model: str
    sequence: str = "excite_12s"
    trials: int = 3
    most_steps: int = 5
    most_experiments: int = 2
    search: Search = field(default_factory=Search)


@dataclass(frozen=True)
class Ending:
    """How it ended.

    Attributes:
        verdict: complete, unknown, undecided, or "step limit".
        effects: all that were added.
        stated: the hypotheses that the last diagnosis leaves.
        sentence: in words.
        model: file of the last model.
        steps: (what was added, gap) of each play of the sequence.
    """

    verdict: str
    effects: tuple[str, ...]
    stated: tuple[str, ...]
    sentence: str
    model: Path
    steps: tuple[tuple[str, Gap], ...]


@dataclass
class Experimenter:
    """One run of the loop.

    Args:
        rig: to play on.
        folder: exists; receives notebook.md and everything else.
        say: told each entry in a line.
        progress: a context that gives what is told of the diagnosis' roll-outs.
    """

    rig: Rig
    plan: Plan
    folder: Path
    notebook: Notebook
    say: Callable[[str], None]
    progress: Callable[[], AbstractContextManager[Told | None]]
    _played: list[tuple[Bags, Gap]] = field(default_factory=list)
    _plays: int = 0
    _repeated: bool = False
    _steps: list[tuple[str, Gap]] = field(default_factory=list)
    _added: list[str] = field(default_factory=list)
    _diagnoses: int = 0
    _experiments: list[str] = field(default_factory=list)

    def run(self) -> Ending:
        """Goes on until the end. What interrupts it is written down and raised again: KeyboardInterrupt, RigFailed,
        InputError."""
        try:
            return self._run()
        except KeyboardInterrupt:
            self._note("Interrupted", "By Ctrl-C. Everything above is on disk.")
            raise
        except (RigFailed, ValueError) as error:
            self._note("The run ended early", str(error))
            raise

    def _run(self) -> Ending:
        model, path = load_model(self.plan.model), self.plan.model
        self._play(self.plan.sequence, model, f"the model as given, {model.name}")
        once: dict[str, float] = {}
        while True:
            reason = self._diagnose(path, once)
            v = reason.diagnosis.verdict
            once = once or {axis: before for axis, (before, _) in v.floor.items()}
            if v.verdict == "undecided" and self._experiment(reason, model):
                continue
            if v.verdict == "unknown" and self._repeat(model):
                continue
            self._experiments.clear()
            named = v.verdict == "effect" and len(self._steps) <= self.plan.most_steps
            model = reason.diagnosis.model if named else reason.diagnosis.base_model
            file = self._save(model)
            self.rig.load(file)
            if not named:
                return self._end(STEP_LIMIT if v.verdict == "effect" else v.verdict, reason, file)
            self._added += v.effects
            words = " and ".join(map(in_words, v.effects))
            self._note(f"Added {words}", *values_page(reason, self.notebook.link(file.name, file)))
            path = str(file)
            self._play(self.plan.sequence, model, f"the model with {words}", "+ " + ", ".join(v.effects))

    def _play(self, sequence: str, model: Model, doing: str, step: str = "as given") -> None:
        """Plays on both sides and writes the gap down."""
        self._plays += 1
        number = self._plays
        bags = self.rig.play(sequence, self.plan.trials, self.folder / f"play_{number}")
        gap = measure_gap(bags, model.rig)
        self._played.append((bags, gap))
        page = self.folder / f"gap_{number}"
        write_gap(gap, bags, page, f"The rig against {model.name}")
        if sequence == self.plan.sequence:
            self._steps.append((step, gap))
        self._note(
            f"Played {Path(sequence).stem}, {self.plan.trials} trials, with {doing}",
            *gap_page(gap, self.notebook, page / "report.html"),
        )

    def _diagnose(self, model: str, once: dict[str, float]) -> Reason:
        self._diagnoses += 1
        self.say("Diagnosing ...")
        with self.progress() as told:
            played, folder = [bags for bags, _ in self._played], self.folder / f"diagnosis_{self._diagnoses}"
            reason = find_reason(model, played, folder, self.plan.search, told, self.rig.limit(), once or None)
        self.rig.tell(reason.content, reason.report)
        self._note(f"Diagnosis: {reason.content['verdict']}", *diagnosis_page(reason, self.notebook))
        return reason

    def _experiment(self, reason: Reason, model: Model) -> bool:
        """Plays what decides; False where there is nothing (new) to play."""
        experiment = reason.diagnosis.experiment
        if experiment is None or len(self._experiments) >= self.plan.most_experiments:
            return False
        if experiment.name in self._experiments:
            return False
        self._experiments.append(experiment.name)
        file = self.folder / f"{experiment.name}.yaml"
        if not file.exists():
            file.write_text(experiment.to_yaml(self.plan.trials), encoding="utf-8")
        self._play(str(file), model, f"the same model, for it decides. {experiment.reason}")
        return True

    def _repeat(self, model: Model) -> bool:
        """Plays once more, instead of what came at uneven times, for no effect explains that; False where nothing did.

        Once only: a rig that is always uneven is unknown indeed.
        """
        known = self.plan.search.timing
        uneven = [gap for _, gap in self._played if gap.jitter > known]
        if not uneven or self._repeated:
            return False
        self._repeated = True
        self._played = [(bags, gap) for bags, gap in self._played if gap.jitter <= known]
        step, late = self._steps.pop()[0], max(gap.jitter for gap in uneven)
        doing = f"the same model, for trials differed as if they had come {1e3 * late:.0f} ms early or late"
        self._play(self.plan.sequence, model, doing, step)
        return True

    def _save(self, model: Model) -> Path:
        name = f"model_{len(self._steps)}"
        return save_model(replace(model, name=name), self.folder / f"{name}.yaml")

    def _end(self, verdict: str, reason: Reason, model: Path) -> Ending:
        v = reason.diagnosis.verdict
        most = self.plan.most_steps
        sentence = v.sentence + (f" It is not added, for {most} steps were allowed." if verdict == STEP_LIMIT else "")
        ending = Ending(verdict, tuple(self._added), v.stated, sentence, model, tuple(self._steps))
        content = {
            "verdict": verdict,
            "sentence": sentence,
            "effects": list(ending.effects),
            "stated": list(v.stated),
            "model": str(model),
            "steps": [{"step": name, "error": g.error, "alikeness": g.alikeness[min(g.alikeness)]}
                      for name, g in self._steps],
        }  # fmt: skip
        (self.folder / "staircase.json").write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
        link = self.notebook.link(model.name, model)
        self._note(f"The end: {verdict}", *ending_page(sentence, self._steps, reason, self.notebook, link))
        return ending

    def _note(self, heading: str, *blocks: str) -> None:
        self.notebook.entry(heading, *blocks)
        self.say(heading)
