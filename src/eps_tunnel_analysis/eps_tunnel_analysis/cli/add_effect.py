# SPDX-License-Identifier: Apache-2.0
"""add-effect: adds effects to a model, fits them, and proves them on samples held out."""

import argparse
import json
import sys
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

from eps_tunnel_analysis.cli.diagnosing import add_diagnosis_arguments, progress
from eps_tunnel_analysis.cli.folder import model_file, refuse_files
from eps_tunnel_analysis.cli.plays import load_recorded
from eps_tunnel_analysis.cli.sides import add_bag_arguments, add_model_arguments
from eps_tunnel_analysis.cli.tables import console, table

NAME = "add-effect"
HELP = "Adds effects to a model, fits them, and proves them on samples held out."
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
    from eps_tunnel_analysis.diagnose.addition import add_effects
    from labyrinth_sim.model import save_model

    out = model_file(arguments.out)
    refuse_files(out)
    recorded = load_recorded(arguments, efforts=True)
    with progress(arguments.progress) as told:
        added = add_effects(recorded.model, recorded.plays, arguments.names, arguments.threads, told, recorded.held)
    content = added.to_json()
    model = replace(
        added.model,
        provenance={
            **recorded.model.provenance,
            "added": list(arguments.names),
            "bags": [f"{path} {digest[:12]}" for path, digest in recorded.bags],
            "date": datetime.now(UTC).strftime("%Y-%m-%d"),
            "held_out_before": added.before.held_out,
            "held_out_after": added.after.held_out,
        },
    )
    save_model(model, out)
    if arguments.json:
        json.dump({"model": str(out), **content}, sys.stdout, indent=1, allow_nan=False)
        print()
        return
    shown = console()
    rows = [(n, f"{v:.5g}") for n, v in added.values.items()]
    table(shown, "Fitted values", ("parameter", "value"), rows)
    shown.print(added.sentence, soft_wrap=True, markup=False)
    shown.print(f"Model: {out}", soft_wrap=True)
