# SPDX-License-Identifier: Apache-2.0
"""new-rig: a robot's own model and recordings to a rig and a model, then the check."""

import argparse
import math
import shlex
from pathlib import Path
from typing import TYPE_CHECKING

from eps_tunnel_analysis.cli.arguments import add_threads_argument, factor
from eps_tunnel_analysis.outputs import new_folder, refuse_existing
from eps_tunnel_analysis.terminal import console, print_next, rollout_progress

if TYPE_CHECKING:
    from eps_tunnel_analysis.new_rig.position import Ticks

NAME = "new-rig"
HELP = "Writes rig and model files from a robot's MJCF or URDF and its recordings, and checks them."
EPILOG = """\
examples:
  eps-tunnel new-rig arm.xml --bag bags/run1 bags/run2 --out arm
  eps-tunnel new-rig so101.urdf --lerobot ~/datasets/so101_pick --position-unit deg --out so101
  eps-tunnel new-rig gantry.xml --csv logs/*.csv --match slide=x_axis --out gantry
  eps-tunnel new-rig pan.xml --csv log.csv --position-unit ticks --ticks-per-turn 4096 --zero 2048 --out pan

Joints are matched by name. Files in --out: rig.yaml and model.yaml with a reason for every value; robot.xml if a joint
has no named actuator or several; bags made from tables. Nothing is fitted yet: calibrate or diagnose does that."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("robot", metavar="MODEL", type=Path, help="the robot's MJCF (.xml) or URDF (.urdf)")
    source = parser.add_mutually_exclusive_group(required=True)
    source.add_argument("--bag", nargs="+", metavar="BAG", type=Path, help="recordings: bags, or folders of bags")
    source.add_argument("--csv", nargs="+", metavar="CSV", type=Path, help="tables, one trial each")
    source.add_argument("--lerobot", metavar="DIR", type=Path, help="a LeRobot dataset, one trial per episode")
    parser.add_argument("--out", metavar="DIR", type=Path, required=True, help="new folder for the files")
    parser.add_argument("--match", nargs="+", metavar="JOINT=RECORDED", type=_pair, default=[],
                        help="joint of the model and its name in the recordings, where they differ")  # fmt: skip
    parser.add_argument("--position-unit", choices=("rad", "deg", "m", "mm", "ticks"),
                        help="unit of recorded positions and targets (default: inferred from their range)")  # fmt: skip
    parser.add_argument("--ticks-per-turn", type=factor, metavar="N",
                        help="for --position-unit ticks, for example 4096; negative if they count the other "
                        "way")  # fmt: skip
    parser.add_argument("--zero", nargs="+", type=_zero, default=[], metavar="[JOINT=]Z",
                        help="tick at which a joint of the model (or every joint) is at 0 (default: 0)")  # fmt: skip
    parser.add_argument("--effort-unit", choices=("N m", "N", "A", "mA", "duty", "raw"),
                        help="unit of recorded efforts (default: inferred from the model's inverse "
                        "dynamics)")  # fmt: skip
    parser.add_argument("--candidates", nargs="+", metavar="EFFECT", help="effects that the check tries (default: all)")
    parser.add_argument("--no-check", action="store_true", help="write the files only")
    add_threads_argument(parser)


def run(arguments: argparse.Namespace) -> None:
    from eps_tunnel_analysis.inputs import bags as bags_in
    from eps_tunnel_analysis.new_rig.joints import read_robot
    from eps_tunnel_analysis.new_rig.tables import csv_bags, lerobot_bags
    from eps_tunnel_analysis.new_rig.write import new_rig
    from eps_tunnel_analysis.recording import read_all
    from labyrinth_sim.errors import InputError, unknown_name
    from labyrinth_sim.model import load_model

    refuse_existing(arguments.out)
    ticks = _ticks(arguments)
    robot = read_robot(arguments.robot)
    strange = [joint for joint, _ in arguments.zero if joint and joint not in robot.joints]
    if strange:
        raise InputError([f"--zero: {unknown_name('joint', joint, robot.joints)}" for joint in strange])
    notes: list[str] = []
    with new_folder(arguments.out) as folder:
        if arguments.bag:
            paths = bags_in(arguments.bag)
        elif arguments.csv:
            paths, notes = csv_bags(arguments.csv, robot.joints, folder / "bags")
        else:
            paths, notes = lerobot_bags(arguments.lerobot, folder / "bags")
        made = new_rig(
            robot, read_all(paths), folder, dict(arguments.match), arguments.position_unit, arguments.effort_unit, ticks
        )
        load_model(made.model)  # errors are raised before the folder gets its name
    model = arguments.out / "model.yaml"
    if not arguments.bag:
        paths = [arguments.out / "bags" / path.name for path in paths]
    out = console()
    known = [rule.replace(str(folder), str(arguments.out)) for rule in made.known]
    for note in (*notes, *made.notes):
        out.print(note, soft_wrap=True, markup=False)
    if not arguments.no_check:
        _check(model, paths, known, arguments)
    out.print(f"Rig: {arguments.out / 'rig.yaml'}\nModel: {model}", soft_wrap=True)
    said = "Next: find out which physical effect the model lacks."
    if known:
        said = "Recorded with different gains: every command with these recordings needs --known as below. " + said
    source = arguments.bag or [arguments.out / "bags"]
    words = ["--real", *map(str, source), *(["--known", *known] if known else []), "--model", str(model)]
    print_next(out, said, shlex.join(["eps-tunnel", "diagnose", *words, "--out", "why"]))


def _ticks(arguments: argparse.Namespace) -> "Ticks | None":
    from eps_tunnel_analysis.new_rig.position import TICKS, Ticks
    from labyrinth_sim.errors import InputError

    given = arguments.ticks_per_turn is not None
    if (arguments.position_unit == TICKS) != given or (arguments.zero and not given):
        raise InputError(
            "--position-unit ticks and --ticks-per-turn N belong together, and --zero to both; expected "
            "--position-unit ticks --ticks-per-turn 4096 --zero 2048."
        )
    return Ticks(arguments.ticks_per_turn, dict(arguments.zero)) if given else None


def _check(model: Path, paths: list[Path], known: list[str], arguments: argparse.Namespace) -> None:
    from eps_tunnel_analysis.check.check import check
    from eps_tunnel_analysis.inputs import load_recorded

    recorded = load_recorded(str(model), paths, known=known, efforts=True)
    with rollout_progress() as progress:
        checked = check(
            recorded.model, recorded.plays, recorded.notes, arguments.candidates, arguments.threads, progress
        )
    for line in checked.lines():
        console().print(line, soft_wrap=True, markup=False)


def _pair(text: str) -> tuple[str, str]:
    joint, equals, recorded = text.partition("=")
    if not (joint and equals and recorded):
        raise argparse.ArgumentTypeError(f"expected JOINT=RECORDED, got '{text}'")
    return joint, recorded


def _zero(text: str) -> tuple[str, float]:
    joint, _, number = text.rpartition("=")
    value = float(number)
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"expected a finite number, got {number}")
    return joint, value
