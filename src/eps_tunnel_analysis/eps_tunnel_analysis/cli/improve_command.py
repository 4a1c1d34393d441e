# SPDX-License-Identifier: Apache-2.0
"""improve: diagnose, add, diagnose again, until nothing more can be named; on recordings, or on a running rig."""

import argparse
import sys
from contextlib import suppress
from pathlib import Path

from eps_tunnel_analysis.cli.arguments import (
    add_bag_arguments,
    add_diagnosis_arguments,
    add_model_arguments,
    add_search_arguments,
    at_least_one,
    diagnosis_options,
)
from eps_tunnel_analysis.outputs import json_text, refuse_existing, shown_share, shown_value
from eps_tunnel_analysis.terminal import console, print_next, print_recordings, rollout_progress, table
from labyrinth_sim.errors import InputError

NAME = "improve"
HELP = (
    "Adds what is missing, step by step, until the model is complete or no known effect explains the remaining error."
)
EPILOG = """\
examples:
  eps-tunnel improve --real bags/real_* --model labyrinth --out better
  eps-tunnel improve --live --emulated --hide '?' --model labyrinth_mx64 --out notebook
  eps-tunnel improve --live --arm --model my_rig --out notebook

If the recordings leave several sets of effects, the effects that all have in common are added; if there are none, the
simplest set is.
Files in --out: step_1/, step_2/ ... with diagnosis.json, report.html and model.yaml each, the models model_1.yaml,
model_2.yaml ... of the steps, and staircase.json; with --live notebook.md and what it links to: bags, gaps, diagnoses,
models, and staircase.json."""
MOST_STEPS = 5
FAILED = 1


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_bag_arguments(parser, required=False)
    add_model_arguments(parser)
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="new folder for every step")
    add_search_arguments(parser)
    add_diagnosis_arguments(parser)
    parser.add_argument("--json", action="store_true", help="print staircase.json, and nothing else, to stdout")
    parser.add_argument("--most-steps", type=at_least_one, default=MOST_STEPS, metavar="N",
                        help="largest number of additions (default: %(default)s)")  # fmt: skip
    live = parser.add_argument_group(
        "live", "Plays on rig and simulation instead of reading recordings; needs ROS 2. Uses the running nodes "
        "(`ros2 launch eps_tunnel_analysis study.launch.py`), unless --emulated starts its own. Ctrl-C stops the rig."
    )  # fmt: skip
    live.add_argument("--live", action="store_true", help="play, compare, diagnose, decide, add, and again")
    live.add_argument("--arm", action="store_true", help="allow it to move the rig whose nodes are running")
    live.add_argument("--emulated", nargs="?", const="healthy", metavar="CONFIG",
                      help="start the emulated testbed, config/testbed/CONFIG (healthy), and all nodes")  # fmt: skip
    live.add_argument("--hide", action="append", default=[], metavar="NAME[.AXIS][=STRENGTH]",
                      help="with --emulated: hide an effect; ? picks one at random, revealed at the end")  # fmt: skip
    live.add_argument("--sequence", default="excite_12s", help="sequence to play at every step (default: %(default)s)")
    live.add_argument("--trials", type=at_least_one, default=3, metavar="N",
                      help="trials of each play (default: %(default)s)")  # fmt: skip


def run(arguments: argparse.Namespace) -> int | None:
    if arguments.live:
        return _improve_live(arguments)
    if not arguments.real:
        raise InputError("--real is missing: give the recordings, or record them now with --live.")
    _improve(arguments)
    return None


def _improve(arguments: argparse.Namespace) -> None:
    from eps_tunnel_analysis.loop.experimenter import Added, Ending, Experimenter, Plan, heading
    from eps_tunnel_analysis.report.next_step import compare_with

    refuse_existing(arguments.out)
    options = diagnosis_options(arguments)
    options.recorded(arguments.model, arguments.real)  # what cannot be read is said before a folder is made
    plan = Plan(arguments.model, most_steps=arguments.most_steps, search=options, recordings=tuple(arguments.real))
    arguments.out.mkdir(parents=True)
    out = console(stderr=arguments.json)
    try:
        for step in Experimenter(plan, arguments.out, progress=lambda: rollout_progress(arguments.progress)).steps():
            out.print(heading(step), soft_wrap=True, markup=False)
            if isinstance(step, Added):
                said = step.addition.sentences
                out.print(" ".join(filter(None, (step.why, *said))), soft_wrap=True, markup=False)
                print_recordings(out, step.addition.plays, step.addition.model.rig.position_unit)
    finally:
        with suppress(OSError):
            arguments.out.rmdir()  # where nothing was done
    assert isinstance(step, Ending)
    if arguments.json:
        print(json_text(step.to_json()), end="")
        return
    named = ["added", "error", "held out", "alikeness, k = 1", "rig against itself"]
    ball = any(stair.ball for stair in step.steps)
    unit = step.last.recorded.model.rig.position_unit
    rows = []
    for stair in step.steps:
        row = [" + ".join(stair.added) or stair.step, *(shown_value(v, unit) for v in (stair.error, stair.held_out))]
        row += map(shown_share, (stair.alikeness, stair.itself))
        row += [shown_value(v, "m") for v in (stair.ball.error, stair.ball.held_out)] if stair.ball else []
        rows.append(row + [""] * (len(named) + 2 * ball - len(row)))
    table(out, "Staircase of error", [*named, *(["ball's error", "held out"] if ball else [])], rows)
    out.print(step.sentence, soft_wrap=True, markup=False)
    out.print(f"Models: {arguments.out}; the last one: {step.model}", soft_wrap=True)
    print_next(
        out, "Next: check the remaining error.", compare_with(step.last.recorded, arguments.real, str(step.model))
    )


def _improve_live(arguments: argparse.Namespace) -> int:
    """Runs the loop on a rig; returns 0, or 1 where the rig failed."""
    from eps_tunnel_analysis.sequence_file import find_sequence
    from labyrinth_sim.registry import Registry

    refuse_existing(arguments.out)
    _check(arguments)
    find_sequence(arguments.sequence)
    Registry.load().check(arguments.candidates or ())
    try:
        from eps_tunnel_analysis.nodes.live_improvement import improve
    except ImportError as error:
        raise InputError(
            f"--live needs ROS 2, which is not found ({error}). Run `source env.bash`, or source your own ROS 2."
        ) from error
    from eps_tunnel_analysis.loop.experimenter import Plan
    from eps_tunnel_analysis.loop.gap import RigFailed
    from eps_tunnel_analysis.processes import TIMING, spare_threads
    from eps_tunnel_analysis.report.next_step import compare_with

    options = diagnosis_options(arguments, TIMING, spare_threads())
    plan = Plan(arguments.model, arguments.sequence, arguments.trials, arguments.most_steps, search=options)
    out = console(stderr=arguments.json)
    try:
        ending = improve(
            plan, arguments.out, arguments.emulated, tuple(arguments.hide),
            lambda: rollout_progress(arguments.progress), lambda line: out.print(line, soft_wrap=True, markup=False),
        )  # fmt: skip
    except RigFailed as error:
        print(f"The loop ended early: {error}", file=sys.stderr)
        return FAILED
    if arguments.json:
        print((arguments.out / "staircase.json").read_text(encoding="utf-8"), end="")
        return 0
    recorded = ending.last.recorded
    real = [bag for bag, _ in recorded.bags]
    print_next(out, "Next: check the remaining error.", compare_with(recorded, real, str(ending.model)))
    return 0


def _check(arguments: argparse.Namespace) -> None:
    useless = [f"--{name}" for name in ("real", "rig", "signals", "effects") if getattr(arguments, name)]
    if useless:
        raise InputError(
            f"--live plays its own recordings of the model's rig and loads models with the library's effects into the "
            f"simulation; {', '.join(useless)} cannot be used with it. Leave it out, or --live."
        )
    if arguments.hide and arguments.emulated is None:
        raise InputError("--hide needs --emulated: only an emulated rig can hide something.")
    if arguments.emulated is not None or arguments.arm:
        return
    if not sys.stdin.isatty():
        raise InputError("This moves the rig whose nodes are running. Confirm with --arm, or try it with --emulated.")
    if (
        input("This moves the rig whose nodes are running. Is the area clear? Type 'arm' to continue: ").strip()
        != "arm"
    ):
        raise InputError("Not armed; nothing was moved.")
