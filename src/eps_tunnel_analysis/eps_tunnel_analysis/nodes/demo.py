# SPDX-License-Identifier: Apache-2.0
"""The whole loop on an emulated rig that hides something: gap, where, why, add, and the gap again."""

import argparse
import os
import signal
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from types import FrameType

from eps_tunnel_analysis.autonomous.rig import RigFailed
from eps_tunnel_analysis.cli.folder import numbered_folder
from eps_tunnel_analysis.nodes.demo_walk import Walk, walk
from eps_tunnel_analysis.nodes.processes import ProcessDied
from eps_tunnel_analysis.nodes.rig_processes import DRAW, EmulatedRig
from eps_tunnel_analysis.sequence_file import find_sequence
from labyrinth_sim.effect import effects
from labyrinth_sim.errors import InputError, unknown_name
from labyrinth_sim.model import load_model

HIDDEN, NOTHING = "gravity_load.y=medium", "none"


def parser() -> argparse.ArgumentParser:
    """Options of `ros2 run eps_tunnel_analysis demo`."""
    p = argparse.ArgumentParser(
        prog="demo",
        description="Hides a physical effect in an emulated rig, plays a sequence on it and on its simulation, says "
        "how far apart they are, where and why, adds what is missing, and plays again. Needs no rig and no screen.",
    )
    p.add_argument("--effect", action="append", default=[], metavar="NAME[.AXIS][=STRENGTH]",
                   help=f"what to hide; {DRAW} draws it and tells it at the end, {NOTHING} hides nothing "
                   f"(default: {HIDDEN}); `ros2 run labyrinth_hw testbed --list` lists them")  # fmt: skip
    p.add_argument("--sequence", default="excite_12s", help="name or path of the sequence (default: %(default)s)")
    p.add_argument("--trials", type=_count, default=3, metavar="N",
                   help="how often it is played each time (default: %(default)s)")  # fmt: skip
    p.add_argument("--model", default="labyrinth_mx64", help="name or path of the model (default: %(default)s)")
    p.add_argument(
        "--testbed", default="healthy", metavar="CONFIG", help="config/testbed/*.yaml (default: %(default)s)"
    )
    p.add_argument("--hw", default="healthy", metavar="CONFIG", help="config/hw/*.yaml (default: %(default)s)")
    p.add_argument("--candidates", nargs="+", metavar="EFFECT", help="effects that are considered (default: all)")
    p.add_argument("--seed", type=int, help="of the testbed's noise and of the draw (default: drawn, told at the end)")
    p.add_argument("--out", type=Path, default=Path("out"), metavar="DIR", help="where demo-N is made (default: out)")
    return p


def main(args: Sequence[str] | None = None) -> int:
    """Returns 0, 2 for bad input, 1 when a process died or the run failed, 130 after Ctrl-C."""
    given = parser().parse_args(_without_ros(sys.argv[1:] if args is None else args))
    began = time.monotonic()
    signal.signal(signal.SIGTERM, _interrupt)
    try:
        find_sequence(given.sequence)
        load_model(given.model)
        _check(given.candidates or ())
        hidden = tuple(name for name in given.effect or [HIDDEN] if name != NOTHING)
        seed = given.seed if given.seed is not None else int.from_bytes(os.urandom(2), "little")
        rig = EmulatedRig(given.testbed, given.hw, hidden, seed)
        folder = numbered_folder(given.out, "demo")
        candidates = tuple(given.candidates) if given.candidates else None
        report = walk(Walk(rig, given.model, given.sequence, given.trials, candidates, folder))
    except InputError as error:
        print(error, file=sys.stderr)
        return 2
    except (ProcessDied, RigFailed) as error:
        print(f"\nThe demo ended early: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("\nInterrupted; what was recorded until then is whole.", file=sys.stderr)
        return 130
    print(f"Done in {time.monotonic() - began:.0f} s. Page with pictures: {report.resolve()}")
    return 0


def _check(candidates: Sequence[str]) -> None:
    unknown = [unknown_name("effect", name, effects()) for name in candidates if name not in effects()]
    if unknown:
        raise InputError(unknown)


def _without_ros(args: Sequence[str]) -> list[str]:
    given = list(args)
    return given[: given.index("--ros-args")] if "--ros-args" in given else given


def _count(text: str) -> int:
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"expected a whole number of at least 1, got '{text}'")
    return int(text)


def _interrupt(number: int, frame: FrameType | None) -> None:
    raise KeyboardInterrupt


if __name__ == "__main__":
    sys.exit(main())
