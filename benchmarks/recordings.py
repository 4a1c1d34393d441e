# SPDX-License-Identifier: Apache-2.0
"""Other people's recordings of real rigs, from their files to a verdict: `python benchmarks/recordings.py --data DIR`.

A rig is an MJCF of physical facts and a text in benchmarks/recordings, and an entry here; all else is done by
`eps-tunnel new-rig`, `check` and `diagnose`. Writes the figures as JSON (--json) and pages into docs/recordings
(--pages): the text, the figures between two marks, and whatever a page has below them, which is kept. Commands
with a log in --work are not run again.
"""

import argparse
import itertools
import json
import os
import shlex
import shutil
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
PAGES = HERE.parent / "docs" / "recordings"
BEGIN, END = "<!-- figures: begin -->", "<!-- figures: end -->"


@dataclass(frozen=True)
class Recorded:
    """One rig's recordings.

    Attributes:
        fitted, held_out: bags or folders of bags, from the rig's folder on.
        options: of new-rig.
        unit: of the errors, as `diagnosis.json` has them, and what they are multiplied by to be shown.
    """

    fitted: tuple[str, ...]
    held_out: tuple[str, ...] = ()
    options: tuple[str, ...] = ()
    unit: tuple[str, float] = ("mrad", 1e3)


KEPT = (
    "verdict", "effects", "stated_set", "set", "sentence", "axes", "given", "refitted", "after", "values",
    "evaluations", "held_out_as_given", "held_out_before", "held_out_after", "proposed_effect", "notes",
)  # fmt: skip
"""Of diagnosis.json."""


def _each(first: tuple[str, ...], second: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(f"{a}/{b}" for a in first for b in second)


RIGS = {
    "mx106_no_load": Recorded(
        fitted=("motor_0/step", "motor_0/triangle"), held_out=("motor_0/sine",), options=("--effort-unit", "A")
    ),
    "xl330_pendulum": Recorded(
        fitted=_each(("kp_100", "kp_200", "kp_400"), ("sin_sin", "lift_and_drop", "up_and_down")),
        held_out=_each(("kp_100", "kp_200", "kp_400"), ("sin_time_square",)),
    ),
    "sts3215_pendulum": Recorded(
        fitted=_each(("kp_32",), ("sin_sin", "lift_and_drop", "up_and_down", "brutal")),
        held_out=("kp_32/sin_time_square",),
    ),
    "emps_linear_axis": Recorded(fitted=("plain",), unit=("um", 1e6)),
    "flexible_beam": Recorded(fitted=("sweep_25", "sweep_50"), held_out=("sweep_75",)),
}


@dataclass(frozen=True)
class Ran:
    """A command that was run.

    Attributes:
        words: as typed, with folders as `$DATA` and `$WORK`.
        code: its exit code.
        processor, wall: s.
        output: what it printed.
    """

    words: list[str]
    code: int
    processor: float
    wall: float
    output: str


def ran(words: list[str], log: Path, data: Path, work: Path, threads: int) -> Ran:
    """Runs a command unless its log says that it was; the log is kept next to its files."""
    if log.is_file():
        return Ran(**json.loads(log.read_text(encoding="utf-8")))
    print(shlex.join(words), file=sys.stderr, flush=True)
    begun, before = time.monotonic(), os.times()
    done = subprocess.run([*words, "--threads", str(threads)], capture_output=True, text=True, check=False)
    after = os.times()
    spent = after.children_user + after.children_system - before.children_user - before.children_system
    typed = [word.replace(str(data), "$DATA").replace(str(work), "$WORK") for word in words]
    result = Ran(typed, done.returncode, spent, time.monotonic() - begun, done.stdout + done.stderr)
    log.write_text(json.dumps(result.__dict__), encoding="utf-8")
    return result


def measured(name: str, data: Path, work: Path, threads: int) -> dict[str, Any]:
    """From one rig's files to its verdict, and the figures of it. Stops at the first command that fails."""
    rig, tool = RIGS[name], shutil.which("eps-tunnel") or "eps-tunnel"
    at = [data / name / part for part in rig.fitted]
    held = [data / name / part for part in rig.held_out]
    files = work / name
    words = [tool, "new-rig", str(HERE / "recordings" / f"{name}.xml"), "--bag", *map(str, (*at, *held))]
    words += [*rig.options, "--out", str(files), "--no-check"]
    steps = [ran(words, work / f"{name}.new-rig", data, work, threads)]
    figures: dict[str, Any] = {"name": name, "commands": [], "verdict": None}
    if steps[0].code == 0:
        known = _known(steps[0].output)
        own = ["--model", str(files / "model.yaml"), *(["--known", *known] if known else [])]
        steps.append(ran([tool, "check", "--real", *map(str, at), *own], work / f"{name}.check", data, work, threads))
        beside = ["--held-out", *map(str, held)] if held else []
        words = [tool, "diagnose", "--real", *map(str, at), *beside, *own, "--out", str(work / f"{name}.why")]
        steps.append(ran(words, work / f"{name}.diagnose", data, work, threads))
    for step in steps:
        cost = {"exit": step.code, "processor_s": step.processor, "wall_s": step.wall}
        figures["commands"].append({"words": ["eps-tunnel", *step.words[1:]], **cost})
    file = work / f"{name}.why" / "diagnosis.json"
    if file.is_file():
        diagnosis = json.loads(file.read_text(encoding="utf-8"))
        figures |= {key: diagnosis.get(key) for key in KEPT}
    else:
        figures["trouble"] = steps[-1].output[-2000:]
    return figures


def _known(output: str) -> list[str]:
    """The rules in the command that new-rig prints for recordings with different gains."""
    words = next((shlex.split(line) for line in output.splitlines() if line.lstrip().startswith("eps-tunnel ")), [])
    rules = words[words.index("--known") + 1 :] if "--known" in words else []
    return list(itertools.takewhile(lambda word: not word.startswith("--"), rules))


def page_text(figures: dict[str, Any], rig: Recorded) -> str:
    """The figures of one rig as Markdown."""
    lines = ["```console"]
    lines += [f"$ {_typed(one['words'])}" for one in figures["commands"]]
    lines += ["```", ""]
    if figures["verdict"] is None:
        return "\n".join([*lines, "No verdict: the last command failed.", ""])
    lines += [f"**{figures['verdict']}**: {figures['sentence']}", ""]
    lines += ["| axis | hypothesis | probability |", "|---|---|---|"]
    for axis, one in figures["axes"].items():
        marginals = sorted(one["marginals"].items(), key=lambda item: -item[1])
        lines += [f"| {axis} | {name} | {p:.2f} |" for name, p in marginals if p >= 0.02]
    lines += ["", "| signal | floors that remain |", "|---|---|"]
    for one in figures["axes"].values():
        lines += [f"| {signal} | {_number(floors)} |" for signal, floors in one["remaining"].items()]
        before, after = one["floors"]
        lines += [f"| all, refitted -> with effects | {_number(before)} -> {_number(after)} |"]
    unit, scale = rig.unit
    lines += ["", f"| recording | | as given, {unit} | refitted, {unit} | after, {unit} |", "|---|---|---|---|---|"]
    for given, refitted, after in zip(figures["given"], figures["refitted"], figures["after"], strict=True):
        kind = "held out" if given["held_out"] else "fitted"
        errors = " | ".join(_number(scale * one["error"]) for one in (given, refitted, after))
        lines.append(f"| {given['name']} | {kind} | {errors} |")
    lines += _law(figures.get("proposed_effect"))
    order = ", ".join((*rig.fitted, *rig.held_out))
    lines += ["", f"Commands are numbered in the order {order}; those held out are numbered separately."]
    spent = [f"{one['words'][1]} {one['processor_s']:.0f} s" for one in figures["commands"]]
    lines += ["", f"Processor time: {', '.join(spent)}; {figures['evaluations']} roll-outs.", ""]
    return "\n".join(lines)


def _law(proposed: dict[str, Any] | None) -> list[str]:
    """The proposed law, if nothing known explains the gap: in words, and what it leaves on left-out stretches."""
    if not proposed:
        return []
    lines = ["", proposed["sentence"]]
    if proposed.get("refit"):
        form = proposed["equation"].replace("|", "\\|")  # within a table
        floors = f"{_number(proposed['base_held_out'])} | {_number(proposed['refit']['held_out'])}"
        lines += ["", "| law | floors without it, left out | with it |", "|---|---|---|", f"| {form} | {floors} |"]
    return lines


def _number(value: float) -> str:
    """To three digits, without a power of ten."""
    return f"{float(f'{value:.3g}'):,.10g}"


def _typed(words: list[str]) -> str:
    """A command as typed, folded at its options."""
    text = " ".join(word if word.startswith("$") else shlex.quote(word) for word in words)
    text = text.replace(str(HERE.parent) + "/", "")
    return text.replace(" --", " \\\n    --")


def write_page(name: str, text: str) -> None:
    """The page of a rig: its text, the figures between the marks, and what the page already has below them."""
    file, about = PAGES / f"{name}.md", (HERE / "recordings" / f"{name}.md").read_text(encoding="utf-8")
    old = file.read_text(encoding="utf-8") if file.is_file() else END
    PAGES.mkdir(parents=True, exist_ok=True)
    file.write_text(f"{about}\n{BEGIN}\n{text}{END}{old.partition(END)[2] or chr(10)}", encoding="utf-8")


def main() -> int:
    """Runs, prints the verdicts, writes JSON and pages; exit code 1 if a rig has no verdict."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, required=True, metavar="DIR", help="folder of the recordings")
    parser.add_argument("--work", type=Path, required=True, metavar="DIR", help="folder for what is made")
    parser.add_argument("--json", type=Path, metavar="OUT", help="file that receives the figures")
    parser.add_argument("--pages", action="store_true", help="write the tables of docs/recordings")
    parser.add_argument("--only", nargs="+", choices=RIGS, default=list(RIGS), metavar="RIG", help=", ".join(RIGS))
    parser.add_argument("--threads", type=int, default=1, help="of this machine (default: 1)")
    options = parser.parse_args()
    options.work.mkdir(parents=True, exist_ok=True)
    all_figures = {}
    for name in options.only:
        figures = measured(name, options.data.resolve(), options.work.resolve(), options.threads)
        all_figures[name] = figures
        print(f"{name}: {figures.get('sentence') or 'no verdict: ' + figures['trouble']}", flush=True)
        if options.pages:
            write_page(name, page_text(figures, RIGS[name]))
    if options.json:
        options.json.write_text(json.dumps(all_figures, indent=2) + "\n", encoding="utf-8")
    return 0 if all(figures["verdict"] for figures in all_figures.values()) else 1


if __name__ == "__main__":
    sys.exit(main())
