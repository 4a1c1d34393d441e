# SPDX-License-Identifier: Apache-2.0
"""Writes what docs/answers.md shows of each verdict: diagnoses four emulated rigs, draws them, quotes their sentences.

    python tools/answers.py [VERDICT...]

Each takes a minute or two; nothing else of the page is changed.
"""

import re
import sys
import tempfile
from dataclasses import dataclass, field
from pathlib import Path

import yaml

from eps_tunnel_analysis.loop.reason import DiagnosisOptions, diagnose_bags
from eps_tunnel_analysis.report.pictures import answer_picture, save
from eps_tunnel_analysis.sequence import Sequence
from eps_tunnel_analysis.sequence_file import find_sequence, parse_sequence
from labyrinth_hw.testbed.bags import write_bag
from labyrinth_hw.testbed.hidden import load_testbed
from labyrinth_hw.testbed.offline import run_offline

DOCS = Path(__file__).resolve().parents[1] / "docs"
PAGE = DOCS / "answers.md"
TRIALS, RATE = 5, 100.0  # Hz

STEP = """
description: One step, and back no more.
initial_deg: {motor_x: 0, motor_y: 0}
command:
  motor_x:
    - hold: {lasts_s: 0.4}
    - step: {to_deg: 3, lasts_s: 2.6}
  motor_y:
    - hold: {lasts_s: 3.0}
"""
ONE_STEP = parse_sequence(yaml.safe_load(STEP), "one_step", "one_step")


@dataclass(frozen=True)
class Case:
    """An emulated rig and how it is diagnosed.

    Attributes:
        hidden: what is wrong with it, as `testbed --effect` takes it.
        model: of the simulation.
        candidates: effects considered, few so that it does not take long.
        sequence: what is played.
    """

    hidden: tuple[str, ...]
    candidates: tuple[str, ...]
    model: str = "labyrinth_manual"
    seed: int = 1
    sequence: Sequence = field(default_factory=lambda: find_sequence("excite_12s"))


CASES = {
    "complete": Case((), ("gravity_load", "sensor_bias")),
    "effect": Case(("gravity_load.x=medium",), ("gravity_load", "return_spring", "coulomb_friction")),
    # One step does not distinguish a slight lag from a slight delay better than this.
    "undecided": Case(("sensor_lag.motor_x=weak",), ("sensor_lag", "sensor_delay"), sequence=ONE_STEP),
    "unknown": Case(("cogging.x=strong",), ("gravity_load", "coulomb_friction")),
}


def answer(kind: str, case: Case, folder: Path) -> str:
    """Records and diagnoses a case, draws docs/pictures/answer_KIND.png, and returns the verdict's sentence."""
    command = case.sequence.commands[0]
    run = run_offline(load_testbed("healthy", case.hidden), *command.sample(RATE), TRIALS, case.seed)
    bag = write_bag(folder / kind, run, case.sequence.name, command.hash)
    options = DiagnosisOptions(case.candidates, case.seed)
    diagnosis = diagnose_bags(case.model, [bag], folder / f"why_{kind}", options).diagnosis
    found = diagnosis.verdict
    if found.verdict != kind:
        raise SystemExit(f"{kind}: the verdict is {found.verdict}. {found.sentence} {dict(found.set)}")
    save(answer_picture(diagnosis), DOCS / "pictures" / f"answer_{kind}.png")
    return found.sentence


def quoted(page: str, kind: str, sentence: str) -> str:
    """The page with the sentence between the marks of a verdict."""
    marks = re.compile(rf"(<!-- answer: {kind} -->\n).*?(<!-- end -->)", re.DOTALL)
    return marks.sub(lambda found: f"{found[1]}> {sentence}\n{found[2]}", page)


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        for kind in sys.argv[1:] or CASES:
            sentence = answer(kind, CASES[kind], Path(folder))
            print(f"{kind}: {sentence}", flush=True)
            if PAGE.exists():
                PAGE.write_text(quoted(PAGE.read_text(encoding="utf-8"), kind, sentence), encoding="utf-8")


if __name__ == "__main__":
    main()
