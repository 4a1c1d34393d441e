# SPDX-License-Identifier: Apache-2.0
"""add-effect: adds effects to a model, fits them, and judges them on what was not fitted."""

import argparse
from pathlib import Path

from eps_tunnel_analysis.cli.arguments import (
    add_bag_arguments,
    add_diagnosis_arguments,
    add_model_arguments,
    diagnosis_options,
)
from eps_tunnel_analysis.outputs import json_text, model_file
from eps_tunnel_analysis.terminal import console, print_next, print_recordings, rollout_progress, table

NAME = "add-effect"
HELP = "Adds effects to a model, fits them as diagnose does, and judges them on what was not fitted."
EPILOG = """\
examples:
  eps-tunnel add-effect backlash.x --real bags/real_* --model labyrinth --out with_backlash.yaml
  eps-tunnel add-effect coulomb_friction.x backlash.y --real bags/real_* --model labyrinth --out m2.yaml"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("names", nargs="+", metavar="NAME", help="EFFECT.PLACE, as diagnose names them")
    add_bag_arguments(parser)
    add_model_arguments(parser)
    parser.add_argument("--out", type=Path, required=True, metavar="M2", help="model file to write")
    add_diagnosis_arguments(parser)
    parser.add_argument("--json", action="store_true", help="print the result as JSON, and nothing else, to stdout")


def run(arguments: argparse.Namespace) -> None:
    from eps_tunnel_analysis.loop.reason import add_to_model
    from eps_tunnel_analysis.report.next_step import after_addition

    out = model_file(arguments.out)
    with rollout_progress(arguments.progress) as progress:
        added, recorded = add_to_model(
            arguments.model, arguments.real, arguments.names, out, diagnosis_options(arguments), progress
        )
    said = added.sentences
    if arguments.json:
        print(json_text({"model": str(out), **added.to_json(), "sentence": " ".join(said)}), end="")
        return
    shown = console()
    known = {n: f"{low:.4g} to {high:.4g}" for n, (low, high) in added.intervals.items()}
    rows = [(n, f"{v:.5g}", known.get(n, "not felt")) for n, v in added.values.items()]
    table(shown, "Fitted values", ("parameter", "value", "95 % interval"), rows)
    print_recordings(shown, added.plays, added.model.rig.position_unit)
    for sentence in said:
        shown.print(sentence, soft_wrap=True, markup=False)
    shown.print(f"Model: {out}", soft_wrap=True)
    print_next(shown, *after_addition(recorded, arguments.real, out))
