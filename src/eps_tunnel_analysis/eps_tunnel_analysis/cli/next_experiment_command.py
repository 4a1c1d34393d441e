# SPDX-License-Identifier: Apache-2.0
"""next-experiment: what to play next, to narrow values or to distinguish effects."""

import argparse
import math
from pathlib import Path
from typing import TYPE_CHECKING

from eps_tunnel_analysis.cli.arguments import (
    add_bag_arguments,
    add_diagnosis_arguments,
    add_model_arguments,
    diagnosis_options,
    within,
)
from eps_tunnel_analysis.outputs import json_text, refuse_files, shown_number
from eps_tunnel_analysis.terminal import console, print_next, print_notes, rollout_progress, table
from labyrinth_sim.errors import InputError
from labyrinth_sim.whole_file import write_new

if TYPE_CHECKING:
    from eps_tunnel_analysis.values.value_experiment import ValueExperiment

NAME = "next-experiment"
HELP = "Designs what to play next: to narrow the model's values, or to decide between effects."
EPILOG = """\
examples:
  eps-tunnel next-experiment --for values --model fitted.yaml --real bags/real_* --out next.yaml
  eps-tunnel next-experiment --for values --model labyrinth_mx64 --free 'drive.x.*' --seconds 8 --out first.yaml
  eps-tunnel next-experiment --for names --model labyrinth --real bags/real_* --out next.yaml

For values: commands from a menu, one after another, with the most information on the values, all axes at once; none
that runs the model into a stop. For names: the sequence that `diagnose` proposes when it is undecided.
Play the file with `eps-tunnel sequences FILE --csv ...` or the sequence player."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--for", dest="goal", choices=("values", "names"), required=True,
                        help="narrow the fitted values, or decide between effects")  # fmt: skip
    add_bag_arguments(parser, required=False)
    add_model_arguments(parser)
    parser.add_argument("--free", nargs="+", metavar="PATTERN",
                        help="values to narrow (default: what each drive declares as free, and all of the model's "
                        "effects)")  # fmt: skip
    parser.add_argument("--seconds", type=within(1.0, 3600.0, "s"), default=12.0, metavar="S",
                        help="longest motion, s (default: %(default)g)")  # fmt: skip
    parser.add_argument("--out", type=Path, required=True, metavar="FILE", help="sequence file to write")
    add_diagnosis_arguments(parser)
    parser.add_argument("--json", action="store_true", help="print the result as JSON, and nothing else, to stdout")


def run(arguments: argparse.Namespace) -> None:
    out = arguments.out if arguments.out.suffix in (".yaml", ".yml") else Path(f"{arguments.out}.yaml")
    refuse_files(out)
    if arguments.goal == "names":
        _for_names(arguments, out)
    else:
        _for_values(arguments, out)


def _for_values(arguments: argparse.Namespace, out: Path) -> None:
    from eps_tunnel_analysis.report.next_step import play_command
    from eps_tunnel_analysis.values.value_experiment import value_experiment
    from labyrinth_sim.model import load_model

    if arguments.real:
        recorded = diagnosis_options(arguments).recorded(arguments.model, arguments.real)
        model, plays, notes = recorded.model, recorded.plays, recorded.notes
    else:
        model, plays, notes = load_model(arguments.model, arguments.effects), (), ()
    designed = value_experiment(model, plays, arguments.free, arguments.seconds, arguments.threads)
    linear = [axis.command for axis in model.rig.axes if axis.slides]
    write_new(out, designed.to_yaml(linear))
    if arguments.json:
        print(json_text({"command": NAME, "file": str(out), **designed.to_json()}), end="")
        return
    _print(designed)
    print_notes(console(), notes)
    print_next(console(), f"Next: play {out}, {designed.command.duration:g} s. Its commands:", play_command(out))


def _print(designed: "ValueExperiment") -> None:
    rows = [
        (
            v.name,
            shown_number(v.value, 4),
            "–" if math.isnan(v.before) else f"± {shown_number(v.before, 2)}",
            f"± {shown_number(v.after, 2)}",
            v.unit,
        )
        for v in designed.values
    ]
    table(console(), "Expected intervals, 95 %", ("value", "now", "known to", "with the play", "unit"), rows)
    for axis, names in designed.pieces.items():
        console().print(f"{axis}: {', '.join(names)}", soft_wrap=True, markup=False)


def _for_names(arguments: argparse.Namespace, out: Path) -> None:
    from eps_tunnel_analysis.diagnose.diagnose import diagnose
    from eps_tunnel_analysis.report.next_step import play_command

    if not arguments.real:
        raise InputError("--for names needs --real: what decides between effects depends on what was recorded.")
    options = diagnosis_options(arguments)
    recorded = options.recorded(arguments.model, arguments.real)
    with rollout_progress(arguments.progress) as progress:
        diagnosis = diagnose(
            recorded.model, recorded.plays, options.seed, None, options.threads, progress, held=recorded.held
        )
    if diagnosis.experiment is None:
        raise InputError(f"{diagnosis.verdict.sentence} No experiment would decide more.")
    write_new(out, diagnosis.experiment.to_yaml())
    if arguments.json:
        experiment = diagnosis.experiment
        content = {"sequence": experiment.name, "rivals": list(experiment.rivals), "reason": experiment.reason}
        print(json_text({"command": NAME, "file": str(out), **content}), end="")
        return
    console().print(diagnosis.verdict.sentence, soft_wrap=True, markup=False)
    console().print(diagnosis.experiment.reason, soft_wrap=True, markup=False)
    print_next(console(), f"Next: play {out}. Its commands:", play_command(out))
