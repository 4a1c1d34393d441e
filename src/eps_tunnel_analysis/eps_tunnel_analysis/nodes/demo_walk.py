# SPDX-License-Identifier: Apache-2.0
"""What the demo shows, step by step."""

import os
import shlex
from dataclasses import dataclass
from pathlib import Path

from eps_tunnel_analysis.autonomous.gap import Gap, measure_gap, write_gap
from eps_tunnel_analysis.autonomous.reason import Reason, Search, find_reason
from eps_tunnel_analysis.autonomous.rig import Bags
from eps_tunnel_analysis.autonomous.truth import judged, told
from eps_tunnel_analysis.cli.compare import print_comparison
from eps_tunnel_analysis.cli.diagnosing import progress
from eps_tunnel_analysis.cli.tables import console, table
from eps_tunnel_analysis.diagnose.verdict import in_words
from eps_tunnel_analysis.nodes.rig_client import RigClient
from eps_tunnel_analysis.nodes.rig_processes import EmulatedRig, hidden_in, rig_processes
from eps_tunnel_analysis.report.loop_report import before_after, loop_report
from labyrinth_sim.model import Model, load_model, save_model

SMALL = 0.01  # probabilities below are not printed


@dataclass(frozen=True)
class Walk:
    """What the demo was asked for; `folder` exists and is empty."""

    rig: EmulatedRig
    model: str
    sequence: str
    trials: int
    candidates: tuple[str, ...] | None
    folder: Path


def walk(asked: Walk) -> Path:
    """Runs the rig and goes once through the loop; returns the report's path."""
    folder, model = asked.folder, load_model(asked.model)
    say = console().print
    say(f"Demo into {folder}: bags, models, logs and reports.", soft_wrap=True)
    with rig_processes(asked.rig, asked.model, folder) as processes, RigClient(processes.check) as rig:
        domain = os.environ["ROS_DOMAIN_ID"]
        say(
            f"Five processes run. To watch them: export ROS_DOMAIN_ID={domain}, then ros2 topic echo /srg",
            soft_wrap=True,
        )
        _title(f"1. How far, and where: rig and simulation play {asked.sequence}, {asked.trials} times")
        bags = rig.play(asked.sequence, asked.trials, folder / "bags")
        before = _gap(bags, model, folder / "gap", f"The rig against {model.name}")
        say(f"The simulation is '{model.name}': {model.description} Alikeness is the share of time in which it stays "
            f"inside what {asked.trials} real trials spanned, k times as wide.", soft_wrap=True)  # fmt: skip
        print_comparison(before.comparison, before.notes)
        _title("2. Why: each effect of the library is fitted to what the simulation leaves over")
        with progress() as count:
            reason = find_reason(asked.model, [bags], folder / "why", Search(asked.candidates), count)
        rig.tell(reason.content, reason.report)
        _tell_reason(reason)
        changed = save_model(reason.diagnosis.model, folder / "model.yaml")
        _title("3. What to do: " + _what_to_do(reason, bags, asked.model))
        rig.load(changed)
        _title("4. Did it help? Both play again")
        again = rig.play(asked.sequence, asked.trials, folder / "bags_again")
        after = _gap(again, model, folder / "gap_again", "The rig against the changed model")
    hidden = hidden_in(folder)
    sentences = [reason.content["sentence"], _fall(before, after), _reveal(reason, asked)]
    rows = before_after(before.comparison, after.comparison)
    table(console(), "Before and after", ("", "before", "after"), rows)
    for sentence in sentences:
        say(sentence, style="bold", soft_wrap=True, markup=False)
    facts = [("hidden", told(hidden)), ("seed", str(asked.rig.seed)), ("model", str(changed))]
    facts += [(name, str(folder / name / "report.html")) for name in ("gap", "why", "gap_again")]
    page = loop_report(before.comparison, reason.diagnosis, after.comparison, sentences, facts)
    (folder / "report.html").write_text(page, encoding="utf-8")
    return folder / "report.html"


def _title(text: str) -> None:
    console().print(f"\n{text}", style="bold", soft_wrap=True, markup=False)


def _gap(bags: Bags, model: Model, folder: Path, title: str) -> Gap:
    gap = measure_gap(bags, model.rig)
    write_gap(gap, bags, folder, title)
    return gap


def _tell_reason(reason: Reason) -> None:
    v = reason.diagnosis.verdict
    rows = [(name, f"{p:.1%}", "*" if name in v.stated else "") for name, p in v.set.items() if p >= SMALL]
    table(console(), "Hypotheses", ("hypothesis", "probability", "in the stated set"), rows)
    for line in (v.sentence, *(f"Note: {note}" for note in v.notes)):
        console().print(line, soft_wrap=True, markup=False)


def _what_to_do(reason: Reason, bags: Bags, model: str) -> str:
    """What the demo does about it, honest about verdicts that name nothing."""
    v = reason.diagnosis.verdict
    names = " and ".join(map(in_words, v.effects))
    command = ["eps-tunnel", "add-effect", *v.effects, "--real", *map(str, bags.real), "--model", model]
    line = shlex.join([*command, "--out", "more.yaml"])
    if v.verdict == "effect":
        fall = 1 - v.after.held_out / v.before.held_out
        return f"{names} is added; on samples held out the error falls by {fall:.0%}. By hand: {line}"
    if v.verdict == "undecided" and v.effects:
        return (f"these recordings do not decide. To see what it would do, the most probable, {names}, is added. A "
                f"careful experimenter plays {reason.folder / 'next_experiment.yaml'} first, as eps-tunnel improve "
                "--live does.")  # fmt: skip
    return "nothing is added, for nothing is named; the model's own values are refitted."


def _fall(before: Gap, after: Gap) -> str:
    old, new = (f"{1000 * gap.error:.2f} mrad" for gap in (before, after))
    change = 1 - after.error / before.error
    verb = f"fell by {change:.0%}" if change > 0 else f"rose by {-change:.0%}"
    k1 = [f"{100 * min(gap.alikeness.items())[1]:.1f} %" for gap in (before, after)]
    return f"On a fresh play the error {verb}, from {old} to {new}; alikeness at k = 1 went from {k1[0]} to {k1[1]}."


def _reveal(reason: Reason, asked: Walk) -> str:
    v, hidden = reason.diagnosis.verdict, hidden_in(asked.folder)
    named = v.effects if v.verdict == "effect" else ()
    return f"Hidden in the testbed: {told(hidden)}. {judged(hidden, named, v.verdict, v.stated)}"
