# SPDX-License-Identifier: Apache-2.0
"""eps-tunnel calibrate: fits a model's values to recordings."""

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from eps_tunnel_analysis.cli.arguments import (
    add_bag_arguments,
    add_held_out_argument,
    add_known_argument,
    add_model_arguments,
    add_threads_argument,
    at_least_one,
    reading_of,
)
from eps_tunnel_analysis.outputs import json_text
from eps_tunnel_analysis.processes import INTERRUPTED
from eps_tunnel_analysis.terminal import console, fit_bars, print_calibration, print_next
from labyrinth_sim.errors import InputError

if TYPE_CHECKING:
    from eps_tunnel_analysis.calibration.calibrate import Method, Settings

NAME = "calibrate"
HELP = "Fits a model's values to recordings of the real rig."
EPILOG = """\
examples:
  eps-tunnel calibrate --real bags/rotations_x --model labyrinth --out mine.yaml
  eps-tunnel calibrate --real bags/* --model labyrinth --method es --signals motor_x motor_y --out es.yaml
  eps-tunnel calibrate --real bags/* --model mine.yaml --free 'backlash.*' drive.x.delay --hold-out 3 --out m2.yaml

Trials of different commands may be in one bag or in several: they are sorted by the sequence they play. A fifth of the
commands (none if there are fewer than five) is held out of the fit and judged afterwards. In addition to the model
M2.yaml, the complete result is written to M2.fit.json. Ctrl-C ends the fit and keeps the best so far, with exit
code 130."""
METHOD_NAMES = ("cma", "es", "gauss-newton")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_bag_arguments(parser)
    add_model_arguments(parser)
    add_known_argument(parser)
    add_held_out_argument(parser)
    parser.add_argument("--out", type=Path, required=True, metavar="M2",
                        help="model file to write; M2.fit.json, next to it, describes the fit")  # fmt: skip
    fit = parser.add_argument_group("fit")
    fit.add_argument("--method", choices=METHOD_NAMES, default="gauss-newton",
                     help="es: the paper's (5 + 100) evolution strategy; cma: CMA-ES with restarts; gauss-newton: "
                     "multistart least squares with a CMA-ES polish (default: %(default)s)")  # fmt: skip
    fit.add_argument("--fitness", choices=("error", "srg"), default="error",
                     help="error: the paper's equations 10 and 11; srg: the alikeness, averaged over k = 0..5 "
                     "(default: %(default)s)")  # fmt: skip
    fit.add_argument("--free", nargs="+", metavar="PATTERN",
                     help="parameters to fit, as drive.x.p or 'backlash.*' (default: what each drive declares as free, "
                     "and all of the model's effects)")  # fmt: skip
    fit.add_argument("--axis", action=argparse.BooleanOptionalAction,
                     help="fit axis by axis, each to its own signals and to the commands that move it (default: only "
                     "with --method es, as in the paper)")  # fmt: skip
    fit.add_argument("--hold-out", type=_amount, metavar="N",
                     help="commands to hold out: a number, or a share below 1 (default: 0.2, rounded down)"
                     )  # fmt: skip
    fit.add_argument("--seed", type=int, default=0, help="seed of all random numbers (default: %(default)s)")
    fit.add_argument("--generations", type=at_least_one, metavar="N", help="generations of es (default: 150)")
    fit.add_argument(
        "--budget",
        type=at_least_one,
        metavar="N",
        help="largest number of evaluations per fit; the last batch may exceed it",
    )
    work = parser.add_argument_group("work")
    work.add_argument("--checkpoint", type=Path, metavar="FILE",
                      help="keeps every result of the simulator; the same call with the same file resumes where it "
                      "stopped, with the same result")  # fmt: skip
    work.add_argument("--scheduler", metavar="tcp://HOST:PORT", help="Dask scheduler whose workers run the simulations")
    add_threads_argument(work)
    work.add_argument("--progress", choices=("bar", "lines", "none"), default="bar",
                      help="on stderr: a bar, one JSON object a line, or nothing (default: %(default)s)")  # fmt: skip
    parser.add_argument("--json", action="store_true", help="print the result as JSON, and nothing else, to stdout")


def _amount(text: str) -> float:
    value = float(text)
    if not 0 <= value < float("inf") or (value >= 1 and value != int(value)):
        raise argparse.ArgumentTypeError(f"must be a whole number of commands, or a share from 0 to 1, got {text}")
    return value


def run(arguments: argparse.Namespace) -> int:
    from eps_tunnel_analysis.calibration.calibrate import Settings
    from eps_tunnel_analysis.calibration.from_bags import calibrate_bags, free_of, model_and_result
    from eps_tunnel_analysis.inputs import held_apart, load_recorded
    from eps_tunnel_analysis.report.next_step import compare_with

    files = model_and_result(arguments.out)
    recorded = load_recorded(
        arguments.model, arguments.real, reading_of(arguments), effects=arguments.effects,
        known=arguments.known or (), held_out=arguments.held_out or (),
    )  # fmt: skip
    recorded, held = held_apart(recorded, arguments.hold_out, arguments.seed)
    free = free_of(recorded, arguments.free or (), arguments.signals or ())
    settings = Settings(
        method=_method(arguments),
        fitness=arguments.fitness,
        seed=arguments.seed,
        signals=tuple(arguments.signals) if arguments.signals else None,
        held_out=held,
        nthread=arguments.threads,
        journal=arguments.checkpoint,
        budget=arguments.budget,
    )
    axis_by_axis = arguments.axis if arguments.axis is not None else arguments.method == "es"
    with _work(arguments.scheduler, settings) as settings, fit_bars(arguments.progress) as bars:
        calibration = calibrate_bags(recorded, free, settings, axis_by_axis, files, bars)
    if arguments.json:
        print(json_text(calibration.content), end="")
    else:
        print_calibration(calibration.result, calibration.notes)
        console().print(f"Model: {files[0]}\nResult: {files[1]}", soft_wrap=True)
        print_next(console(), "Next: check the remaining error.", compare_with(recorded, arguments.real, str(files[0])))
    return INTERRUPTED if calibration.result.interrupted else 0


def _method(arguments: argparse.Namespace) -> "Method | str":
    from eps_tunnel_analysis.fit.methods import CmaEs, EvolutionStrategy

    if arguments.generations is not None:
        if arguments.method != "es":
            raise InputError(f"--generations is for --method es; limit {arguments.method} with --budget.")
        return EvolutionStrategy(generations=arguments.generations)
    if arguments.method == "cma" and arguments.budget:
        return CmaEs(budget=arguments.budget)
    return str(arguments.method)


@contextmanager
def _work(scheduler: str | None, settings: "Settings") -> "Iterator[Settings]":
    if scheduler is None:
        yield settings
        return
    from eps_tunnel_analysis.fit.cluster import cluster

    with cluster(scheduler) as spread:
        yield replace(settings, spread=spread)
