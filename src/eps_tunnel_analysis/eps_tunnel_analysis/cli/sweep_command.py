# SPDX-License-Identifier: Apache-2.0
"""sweep: what changing a value would do."""

import argparse
import csv
import math
from pathlib import Path
from typing import TYPE_CHECKING

from eps_tunnel_analysis.cli.arguments import (
    add_bag_arguments,
    add_known_argument,
    add_model_arguments,
    add_threads_argument,
    positive,
    reading_of,
)
from eps_tunnel_analysis.outputs import (
    circumstances,
    json_text,
    new_folder,
    refuse_existing,
    shown_number,
    shown_share,
    shown_value,
)
from eps_tunnel_analysis.terminal import ITSELF, console, print_notes, rollout_progress, table

if TYPE_CHECKING:
    from eps_tunnel_analysis.values.sweep import Sweep

NAME = "sweep"
HELP = "Alikeness and error over one or two values of the model: what changing them would do."
EPILOG = """\
examples:
  eps-tunnel sweep drive.x.p --real bags/real_* --model fitted.yaml --out over_p
  eps-tunnel sweep backlash.x.width=0:0.02 drive.x.delay=0.01:0.05:9 --real bags/real_* --model labyrinth --out pair

Without a range, a value goes from half to twice the model's value, or over its full bounds if that is 0. Ranges
are in the unit of the value. An effect that the model lacks is added, with everything off except the swept value.
Files in --out: sweep.svg, sweep.csv (SI units), sweep.json."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("values", nargs="+", metavar="NAME[=LOW:HIGH[:N]]", help="one value of the model, or two")
    add_bag_arguments(parser)
    add_model_arguments(parser)
    add_known_argument(parser)
    parser.add_argument("--k", nargs="+", type=positive, metavar="K",
                        help="factors on the real tunnel's width (default: 1 2 3 4 5)")  # fmt: skip
    parser.add_argument("--out", type=Path, metavar="DIR", help="write picture and table into a new folder")
    add_threads_argument(parser)
    parser.add_argument("--json", action="store_true", help="print the result as JSON, and nothing else, to stdout")


def run(arguments: argparse.Namespace) -> None:
    from eps_tunnel_analysis.alikeness import KS
    from eps_tunnel_analysis.inputs import load_recorded
    from eps_tunnel_analysis.values.sweep import sweep

    if arguments.out:
        refuse_existing(arguments.out)
    recorded = load_recorded(
        arguments.model, arguments.real, reading_of(arguments), effects=arguments.effects, known=arguments.known or ()
    )
    with rollout_progress() as progress:
        swept = sweep(
            recorded.model, recorded.plays, arguments.values, arguments.k or KS, arguments.signals, arguments.threads,
            progress,
        )  # fmt: skip
    content = {
        "command": NAME,
        "model": recorded.model.name,
        "sources": [[str(path), digest] for path, digest in recorded.bags],
        "made": [list(fact) for fact in circumstances()],
        **swept.to_json(),
    }
    if arguments.out:
        from eps_tunnel_analysis.report.values_pictures import save_svg, sweep_picture

        with new_folder(arguments.out) as folder:
            save_svg(sweep_picture(swept), folder / "sweep.svg")
            _write_csv(folder / "sweep.csv", swept)
            (folder / "sweep.json").write_text(json_text(content), encoding="utf-8")
    if arguments.json:
        print(json_text(content), end="")
        return
    _print(swept)
    print_notes(console(), (*recorded.notes, *swept.notes))
    if arguments.out:
        console().print(f"Picture: {(arguments.out / 'sweep.svg').resolve()}", soft_wrap=True)


def _write_csv(path: Path, swept: "Sweep") -> None:
    header, rows = swept.rows()
    with path.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        writer.writerow(header)
        writer.writerows(rows)


def _print(swept: "Sweep") -> None:
    content = swept.to_json()
    names = [v.name for v in swept.values]
    for v in swept.values:
        points = (
            f"{len(v.points)} points from {shown_number(v.points[0], 4)} to {shown_number(v.points[-1], 4)} {v.unit}"
        )
        console().print(f"{v.name}: {points}; the model has {shown_number(v.given, 4)}", soft_wrap=True, markup=False)
    least = content["least_error"]
    rows = [("least error E", shown_value(swept.best(swept.mean_error, False)[1], swept.units[0]), least["at"])]
    for best, rig in zip(content["most_alike"], swept.itself, strict=True):
        rows.append((f"most alike, k = {best['k']:g}", shown_share(best["alikeness"]), best["at"]))
        rows += [] if math.isnan(rig) else [(f"  {ITSELF}", shown_share(rig), {})]
    table(
        console(), "Best within the range", ("", "", *names),
        [(what, figure, *(shown_number(at[n], 4) if at else "" for n in names)) for what, figure, at in rows],
    )  # fmt: skip
