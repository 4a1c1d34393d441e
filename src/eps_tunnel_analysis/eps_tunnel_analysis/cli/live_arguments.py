# SPDX-License-Identifier: Apache-2.0
"""--live of `improve`: the loop on a rig that runs, or on the emulated one."""

import argparse
import json
import sys

from eps_tunnel_analysis.cli.folder import refuse_existing
from eps_tunnel_analysis.cli.tables import console
from labyrinth_sim.errors import InputError, unknown_name

FAILED = 1


def add_live_arguments(parser: argparse.ArgumentParser) -> None:
    """What --live needs."""
    live = parser.add_argument_group(
        "live", "Plays on rig and simulation instead of reading recordings; needs ROS 2. Joins the nodes that run "
        "(`ros2 launch eps_tunnel_analysis study.launch.py`), unless --emulated starts its own. Ctrl-C stops the rig."
    )  # fmt: skip
    live.add_argument("--live", action="store_true", help="play, compare, diagnose, decide, add, and again")
    live.add_argument("--arm", action="store_true", help="let it move the rig whose nodes run")
    live.add_argument("--emulated", nargs="?", const="healthy", metavar="CONFIG",
                      help="start the emulated testbed, config/testbed/CONFIG (healthy), and all nodes")  # fmt: skip
    live.add_argument("--hide", action="append", default=[], metavar="NAME[.AXIS][=STRENGTH]",
                      help="with --emulated: hide an effect; ? draws one. It is told at the end")  # fmt: skip
    live.add_argument("--sequence", default="excite_12s", help="played at every step (default: %(default)s)")
    live.add_argument("--trials", type=_count, default=3, metavar="N", help="of each play (default: %(default)s)")
    live.add_argument("--most-steps", type=_count, default=5, metavar="N",
                      help="additions after which it stops (default: %(default)s)")  # fmt: skip


def improve_live(arguments: argparse.Namespace) -> int:
    """Runs the loop; returns 0, or 1 where the rig failed."""
    from eps_tunnel_analysis.sequence_file import find_sequence
    from labyrinth_sim.effect import effects

    refuse_existing(arguments.out)
    _check(arguments)
    find_sequence(arguments.sequence)
    unknown = [unknown_name("effect", n, effects()) for n in arguments.candidates or () if n not in effects()]
    if unknown:
        raise InputError(unknown)
    try:
        from eps_tunnel_analysis.nodes.live_improvement import Asked, improve
    except ImportError as error:
        raise InputError(
            f"--live needs ROS 2, which is not found ({error}). Run `source env.bash`, or source your own ROS 2."
        ) from error
    from eps_tunnel_analysis.autonomous.experimenter import Plan
    from eps_tunnel_analysis.autonomous.reason import Search
    from eps_tunnel_analysis.autonomous.rig import RigFailed
    from eps_tunnel_analysis.command_process import TIMING

    candidates = tuple(arguments.candidates) if arguments.candidates else None
    timing = TIMING if arguments.timing is None else arguments.timing
    plan = Plan(
        arguments.model, arguments.sequence, arguments.trials, arguments.most_steps,
        search=Search(candidates, arguments.seed, arguments.threads, timing),
    )  # fmt: skip
    out = console(stderr=arguments.json)
    try:
        improve(Asked(plan, arguments.out, arguments.emulated, tuple(arguments.hide), arguments.seed,
                      arguments.progress, lambda line: out.print(line, soft_wrap=True, markup=False)))  # fmt: skip
    except RigFailed as error:
        print(f"The loop ended early: {error}", file=sys.stderr)
        return FAILED
    if arguments.json:
        json.dump(json.loads((arguments.out / "staircase.json").read_text(encoding="utf-8")), sys.stdout, indent=1)
        print()
    return 0


def _check(arguments: argparse.Namespace) -> None:
    useless = [f"--{name}" for name in ("real", "rig", "signals", "effects") if getattr(arguments, name)]
    if useless:
        raise InputError(
            f"--live plays its own recordings of the model's rig and loads models with the library's effects into the "
            f"simulation; {', '.join(useless)} cannot be heeded. Leave it out, or --live."
        )
    if arguments.hide and arguments.emulated is None:
        raise InputError("--hide needs --emulated: only an emulated rig can hide something.")
    if arguments.emulated is not None or arguments.arm:
        return
    if not sys.stdin.isatty():
        raise InputError("This moves the rig whose nodes run. Say so by --arm, or try it by --emulated.")
    if input("This moves the rig whose nodes run. Is it clear? Type 'arm' to go on: ").strip() != "arm":
        raise InputError("Not armed; nothing was moved.")


def _count(text: str) -> int:
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"expected a whole number of at least 1, got '{text}'")
    return int(text)
