# SPDX-License-Identifier: Apache-2.0
"""export: a model for the user's own simulator."""

import argparse
from dataclasses import asdict
from pathlib import Path

from eps_tunnel_analysis.outputs import json_text, refuse_files
from eps_tunnel_analysis.terminal import console, table
from labyrinth_sim.whole_file import folder_of, write_new

NAME = "export"
HELP = "Writes a model as an MJCF, and a Python module for what acts between MuJoCo's steps."
EPILOG = """\
examples:
  eps-tunnel export --model better.yaml --mjcf better.xml

The MJCF has everything that MuJoCo can express: inertia, friction, springs, belts, actuators with their limits, and
delays of whole samples if nothing else remains. The rest (other delays, backlash without a belt, friction that
depends on load) is in the module better_effects.py next to it, which needs only numpy and mujoco:
Simulation(model, data).step(target) steps one sample. No module is written where none is needed; each actuator's
control is then its axis's target."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--model", metavar="M", required=True, help="a name in config/models or a file")
    parser.add_argument("--effects", metavar="DIR", type=Path, help="folder with your own effect files")
    parser.add_argument("--mjcf", metavar="FILE", type=Path, required=True, help="MJCF to write")
    parser.add_argument("--module", metavar="FILE", type=Path,
                        help="module to write where one is needed (default: FILE_effects.py)")  # fmt: skip
    parser.add_argument("--json", action="store_true", help="print the place of each value as JSON, and nothing else")


def run(arguments: argparse.Namespace) -> None:
    from labyrinth_sim.export.export import export
    from labyrinth_sim.model import load_model

    module = arguments.module or arguments.mjcf.with_name(f"{arguments.mjcf.stem}_effects.py")
    refuse_files(arguments.mjcf, module)
    exported = export(load_model(arguments.model, arguments.effects))
    with folder_of(arguments.mjcf):
        write_new(arguments.mjcf, exported.mjcf, "--mjcf")
        try:
            if exported.module:
                write_new(module, exported.module, "--module")
        except BaseException:
            arguments.mjcf.unlink()  # alone it is another model
            raise
    files = {"mjcf": str(arguments.mjcf), "module": str(module) if exported.module else None}
    if arguments.json:
        print(json_text({"command": NAME, **files, "values": [asdict(p) for p in exported.placements]}), end="")
        return
    rows = [(p.name, p.where, p.how, f"{p.value:.5g}", p.unit) for p in exported.placements]
    table(console(), "Where each value went", ("value", "file", "by", "number", "unit"), rows, left=3)
    console().print(f"MJCF: {files['mjcf']}", soft_wrap=True)
    module_note = (
        f"Module: {files['module']}" if exported.module else "No module is needed: the controls are the targets."
    )
    console().print(module_note, soft_wrap=True)
