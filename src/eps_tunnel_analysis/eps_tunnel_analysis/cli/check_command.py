# SPDX-License-Identifier: Apache-2.0
"""check: whether recordings are good enough, before anything is fitted."""

import argparse

from eps_tunnel_analysis.cli.arguments import (
    add_bag_arguments,
    add_known_argument,
    add_model_arguments,
    add_threads_argument,
)
from eps_tunnel_analysis.outputs import json_text
from eps_tunnel_analysis.terminal import console, print_next, rollout_progress

NAME = "check"
HELP = "Reports the quality of recordings and what they can identify, before anything is fitted."
EPILOG = """\
examples:
  eps-tunnel check --real bags/real_* --model labyrinth
  eps-tunnel check --real bags/real_* --model mine.yaml --candidates backlash coulomb_friction --json

A value or an effect is identifiable, weak (hardly visible, or not distinguishable from another), or not excited at all;
then the report says what to play. Deal with the lines that begin with ! first."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_bag_arguments(parser)
    add_model_arguments(parser)
    add_known_argument(parser)
    parser.add_argument("--candidates", nargs="+", metavar="EFFECT", help="effects to try (default: all)")
    add_threads_argument(parser)
    parser.add_argument("--json", action="store_true", help="print the result as JSON, and nothing else, to stdout")


def run(arguments: argparse.Namespace) -> None:
    from eps_tunnel_analysis.check.check import check
    from eps_tunnel_analysis.cli.arguments import reading_of
    from eps_tunnel_analysis.inputs import load_recorded
    from eps_tunnel_analysis.report.next_step import after_check

    recorded = load_recorded(
        arguments.model, arguments.real, reading_of(arguments), effects=arguments.effects,
        known=arguments.known or (), efforts=True,
    )  # fmt: skip
    with rollout_progress() as progress:
        checked = check(
            recorded.model, recorded.plays, recorded.notes, arguments.candidates, arguments.threads, progress
        )
    if arguments.json:
        print(json_text({"command": NAME, "model": recorded.model.name, **checked.to_json()}), end="")
        return
    out = console()
    for line in checked.lines():
        out.print(line, soft_wrap=True, markup=False)
    serious = any(finding.serious for finding in checked.data)
    step = after_check(serious, arguments.real, arguments.model, arguments.effects, arguments.known or ())
    print_next(out, *step)
