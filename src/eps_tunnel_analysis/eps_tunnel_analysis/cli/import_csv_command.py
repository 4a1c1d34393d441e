# SPDX-License-Identifier: Apache-2.0
"""import-csv: a table of samples to a bag."""

import argparse
import math
import sys
from pathlib import Path

from eps_tunnel_analysis.cli.arguments import factor

NAME = "import-csv"
HELP = "Turns a table (CSV with one header line) into a bag, for rigs that log text."
TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
EPILOG = """\
Angles are in rad unless --degrees or --scale says otherwise, times in s unless
--time-unit does. JOINT=COLUMN says which column of the table
belongs to a joint.

example:
  eps-tunnel import-csv run1.csv --time t --command servo=target --position servo=angle --out bags/run1"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("table", metavar="CSV", type=Path, help="the table")
    parser.add_argument("--time", metavar="COLUMN", required=True, help="time of measurement, from any origin")
    for name, text in (
        ("command", "target angle, rad"),
        ("position", "measured angle, rad"),
        ("velocity", "rad/s"),
        ("effort", "in the drive's own unit"),
    ):
        parser.add_argument(
            f"--{name}", dest=f"{name}_columns", metavar="JOINT=COLUMN", nargs="+", type=_pair, default=[],
            required=name == "position", help=text,
        )  # fmt: skip
    parser.add_argument("--degrees", action="store_true", help="angles and speeds of the table are in deg and deg/s")
    parser.add_argument("--scale", type=factor, default=1.0, metavar="F",
                        help="factor from the table's angles and speeds to rad and rad/s, as of a sensor's ticks; on "
                        "top of --degrees")  # fmt: skip
    parser.add_argument("--time-unit", choices=TIME_UNITS, default="s", help="unit of the times (default: %(default)s)")
    parser.add_argument("--namespace", metavar="NS", default="/real", help="/real or /sim (default: %(default)s)")
    parser.add_argument("--out", metavar="DIR", type=Path, required=True, help="the new bag; must not exist")


def run(arguments: argparse.Namespace) -> None:
    from eps_tunnel_analysis.recording.csv_import import CsvColumns, csv_to_bag

    scale = arguments.scale * (math.pi / 180 if arguments.degrees else 1.0)
    maps = {name: dict(getattr(arguments, f"{name}_columns")) for name in ("position", "velocity", "effort")}
    columns = CsvColumns(
        arguments.time, dict(arguments.command_columns), **maps, scale=scale,
        time_scale=TIME_UNITS[arguments.time_unit],
    )  # fmt: skip
    for doubt in csv_to_bag(arguments.table, columns, arguments.out, arguments.namespace):
        print(doubt, file=sys.stderr)
    print(arguments.out)


def _pair(text: str) -> tuple[str, str]:
    joint, equals, column = text.partition("=")
    if not (joint and equals and column):
        raise argparse.ArgumentTypeError(f"expected JOINT=COLUMN, got '{text}'")
    return joint, column
