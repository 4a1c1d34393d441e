# SPDX-License-Identifier: Apache-2.0
"""repair: saves the intact part of a damaged bag."""

import argparse
from pathlib import Path

NAME = "repair"
HELP = "Copies the intact part of a damaged or unfinished bag into a new one; the old bag is not changed."
EPILOG = """\
example:
  eps-tunnel repair out/paper_8s_real --out out/paper_8s_real_repaired"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("bag", metavar="BAG", type=Path, help="the damaged recording")
    parser.add_argument("--out", metavar="DIR", type=Path, required=True, help="the new bag; must not exist")


def run(arguments: argparse.Namespace) -> None:
    from eps_tunnel_analysis.recording.writer import repair

    print(repair(arguments.bag, arguments.out))
