# SPDX-License-Identifier: Apache-2.0
"""compare: how far a simulation is from reality, and where."""

import argparse
from pathlib import Path
from typing import Any

from rich.console import Console

from eps_tunnel_analysis.cli.arguments import (
    add_bag_arguments,
    add_known_argument,
    add_model_arguments,
    positive,
    reading_of,
)
from eps_tunnel_analysis.outputs import json_text, refuse_existing
from eps_tunnel_analysis.terminal import console, print_comparison, print_next

NAME = "compare"
HELP = "Tunnels, alikeness over k, errors, and where the simulation fails."
EPILOG = """\
examples:
  eps-tunnel compare --real bags/real_* --sim bags/sim_* --out gap
  eps-tunnel compare --real bags/real_* --model labyrinth_manual --k 1 2 3 --json

files in --out: report.html, compare.json, alikeness.csv, errors.csv, where.csv, spans.csv, tunnel.csv, and the
pictures as .svg and .png."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_bag_arguments(parser)
    other = parser.add_mutually_exclusive_group(required=True)
    other.add_argument("--sim", nargs="+", metavar="BAG", type=Path, help="recordings of the simulation, as for --real")
    add_model_arguments(parser, group=other)
    add_known_argument(parser)
    tunnel = parser.add_argument_group("tunnels")
    tunnel.add_argument("--k", nargs="+", type=positive, metavar="K",
                        help="factors on the real tunnel's width (default: 1 2 3 4 5)")  # fmt: skip
    tunnel.add_argument("--k-sim", type=positive, default=1.0, metavar="K",
                        help="factor on the simulated tunnel's width (default: %(default)g)")  # fmt: skip
    tunnel.add_argument("--raw", action="store_true", help="do not smooth the limits by equation 12")
    parser.add_argument("--out", type=Path, metavar="DIR", help="write report, tables and pictures into a new folder")
    parser.add_argument("--json", action="store_true", help="print the result as JSON, and nothing else, to stdout")


def run(arguments: argparse.Namespace) -> None:
    from eps_tunnel_analysis.alikeness import KS
    from eps_tunnel_analysis.study import Study

    if arguments.out:
        refuse_existing(arguments.out)
    study = Study(
        tuple(arguments.real), arguments.model, tuple(arguments.sim or ()), reading_of(arguments), arguments.effects,
        tuple(arguments.known or ()),
    )  # fmt: skip
    with _busy("Reading and simulating"):
        gap = study.compare(arguments.k or KS, not arguments.raw, arguments.k_sim)
    if arguments.out:
        with _busy("Writing the report"):
            gap.save(arguments.out)
    if arguments.json:
        print(json_text(gap.to_json()), end="")
    else:
        print_comparison(gap.comparison)
    if arguments.out:
        report = (arguments.out / "report.html").resolve()
        console(stderr=arguments.json).print(f"Report: {report}", soft_wrap=True)
    if not arguments.json:
        print_next(console(), *gap.step)


def _busy(text: str) -> Any:
    return Console(stderr=True).status(text)  # silent where stderr is no terminal
