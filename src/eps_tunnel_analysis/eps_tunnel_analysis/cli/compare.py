# SPDX-License-Identifier: Apache-2.0
"""compare: how far a simulation is from reality, and where."""

import argparse
import json
import shlex
import sys
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console

from eps_tunnel_analysis.cli.folder import new_folder, refuse_existing
from eps_tunnel_analysis.cli.sides import Sides, add_bag_arguments, add_model_arguments, load_sides, positive
from eps_tunnel_analysis.cli.tables import console, table
from eps_tunnel_analysis.cli.versions import versions

if TYPE_CHECKING:
    from eps_tunnel_analysis.compare import Comparison

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
    tunnel = parser.add_argument_group("tunnels")
    tunnel.add_argument("--k", nargs="+", type=positive, default=[1.0, 2.0, 3.0, 4.0, 5.0], metavar="K",
                        help="factors on the real tunnel's width (default: 1 2 3 4 5)")  # fmt: skip
    tunnel.add_argument("--k-sim", type=positive, default=1.0, metavar="K",
                        help="factor on the simulated tunnel's width (default: %(default)g)")  # fmt: skip
    tunnel.add_argument("--raw", action="store_true", help="do not smooth the limits by equation 12")
    parser.add_argument("--out", type=Path, metavar="DIR", help="write report, tables and pictures into a new folder")
    parser.add_argument("--json", action="store_true", help="print the result as JSON, and nothing else, to stdout")


def run(arguments: argparse.Namespace) -> None:
    from eps_tunnel_analysis.compare import compare

    if arguments.out:
        refuse_existing(arguments.out)
    with _busy("Reading and simulating"):
        sides = load_sides(arguments)
        comparison = compare(
            sides.real, sides.sim, arguments.k, not arguments.raw, arguments.k_sim, signals=arguments.signals
        )
    content = {
        "command": NAME,
        "versions": versions(),
        "sources": [list(fact) for fact in sides.facts],
        **comparison.to_json(),
    }
    content["notes"] = [*sides.notes, *content["notes"]]
    if arguments.out:
        from eps_tunnel_analysis.report.files import write_comparison

        title = f"Real against {sides.model.name if sides.model else 'simulation'}"
        with _busy("Writing the report"), new_folder(arguments.out) as folder:
            write_comparison(folder, comparison, content, title, _facts(sides))
    if arguments.json:
        json.dump(content, sys.stdout, indent=1, allow_nan=False)
        print()
    else:
        print_comparison(comparison, sides.notes)
    if arguments.out:
        report = (arguments.out / "report.html").resolve()
        console(stderr=arguments.json).print(f"Report: {report}", soft_wrap=True)


def _busy(text: str) -> Any:
    return Console(stderr=True).status(text)  # silent where stderr is no terminal


def print_comparison(comparison: "Comparison", notes: Sequence[str]) -> None:
    """Tables of alikeness and error, where the simulation fails in words, and notes."""
    from eps_tunnel_analysis.shown import shown_share, shown_value
    from eps_tunnel_analysis.where import sentences

    out = console()
    ks = [a.k_real for a in comparison.alikeness]
    rows = [(name, *(shown_share(a.shares[name]) for a in comparison.alikeness)) for name in comparison.signals]
    if len(rows) > 1:
        rows.append(("jointly", *(shown_share(a.joint) for a in comparison.alikeness)))
    n, trials = len(comparison.real.time), comparison.real.count
    table(
        out,
        f"Alikeness, {trials} real trial{'s' * (trials > 1)} of {n} samples",
        ("signal", *(f"k = {k:g}" for k in ks)),
        rows,
    )
    table(
        out,
        "Error, simulation minus real",
        ("signal", "E (eq. 10)", "RMS", "bias", "worst", "at", "rig repeats within"),
        [
            (
                e.signal,
                *(shown_value(v, e.unit) for v in (e.command_error, e.rms, e.bias, e.worst)),
                f"{e.worst_time:.2f} s",
                shown_value(e.repeat_rms, e.unit),
            )
            for e in comparison.errors
        ],
    )  # fmt: skip
    words = sentences(comparison.where)
    if words:
        out.print("Where it fails", style="bold")
    for sentence in words:
        out.print(f"  {sentence}", soft_wrap=True)
    for note in dict.fromkeys((*notes, *comparison.notes)):
        out.print(f"Note: {note}", soft_wrap=True, markup=False)


def _facts(sides: Sides) -> list[tuple[str, str]]:
    return [
        *sides.facts,
        *(("note", note) for note in sides.notes),
        ("command", shlex.join(["eps-tunnel", *sys.argv[1:]])),
        ("versions", ", ".join(f"{name} {v}" for name, v in versions().items())),
        ("made", datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC")),
    ]
