# SPDX-License-Identifier: Apache-2.0
"""import-csv: a table of samples to a bag."""

import argparse
from pathlib import Path

NAME = "import-csv"
HELP = "Turns a table (CSV with one header line) into a bag, for rigs that log text."
EPILOG = """\
Angles are in rad, times in s. JOINT=COLUMN says which column of the table belongs to a joint.

example:
  eps-tunnel import-csv run1.csv --time t --command servo=target --position servo=angle --out bags/run1"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("table", metavar="CSV", type=Path, help="the table")
    parser.add_argument("--time", metavar="COLUMN", required=True, help="time of measurement in s, from any origin")
    for name, text in (
        ("command", "target angle, rad"),
        ("position", "measured angle, rad"),
        ("velocity", "rad/s"),
        ("effort", "in the drive's own unit"),
    ):
        parser.add_argument(
            f"--{name}", metavar="JOINT=COLUMN", nargs="+", type=_pair, default=[], required=name == "position",
            help=text,
        )  # fmt: skip
    parser.add_argument("--namespace", metavar="NS", default="/real", help="/real or /sim (default: %(default)s)")
    parser.add_argument("--out", metavar="DIR", type=Path, required=True, help="the new bag; must not exist")


def run(arguments: argparse.Namespace) -> None:
    from eps_tunnel_analysis.recording.csv_import import CsvColumns, csv_to_bag

    maps = {name: dict(getattr(arguments, name)) for name in ("position", "velocity", "effort")}
    columns = CsvColumns(arguments.time, dict(arguments.command), **maps)
    print(csv_to_bag(arguments.table, columns, arguments.out, arguments.namespace))


def _pair(text: str) -> tuple[str, str]:
    joint, equals, column = text.partition("=")
    if not (joint and equals and column):
        raise argparse.ArgumentTypeError(f"expected JOINT=COLUMN, got '{text}'")
    return joint, column
