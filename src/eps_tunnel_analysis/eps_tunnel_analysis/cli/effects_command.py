# SPDX-License-Identifier: Apache-2.0
"""effects: the physical effects that a model can have."""

import argparse
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from eps_tunnel_analysis.outputs import json_text
from eps_tunnel_analysis.terminal import console, table

if TYPE_CHECKING:
    from labyrinth_sim.effect import Effect

NAME = "effects"
HELP = "Lists the physical effects that a model can have, or explains some of them."
SHOWN = ("name", "title", "physics", "equation", "stage", "where", "mark", "confused_with", "separated_by", "nameless")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("names", nargs="*", metavar="NAME", help="explain these effects (default: list all)")
    parser.add_argument("--effects", metavar="DIR", type=Path, help="folder with your own effect files")
    parser.add_argument("--json", action="store_true", help="print JSON, and nothing else, to stdout")


def run(arguments: argparse.Namespace) -> None:
    from labyrinth_sim.registry import Registry

    registry = Registry.load(arguments.effects)
    chosen = [registry.effect(name) for name in arguments.names] or list(registry.effects.values())
    if arguments.json:
        content = [
            {**{key: getattr(e, key) for key in SHOWN}, "parameters": [asdict(p) for p in e.parameters]} for e in chosen
        ]
        print(json_text(content), end="")
    elif arguments.names:
        for effect in chosen:
            _show(effect)
    else:
        rows = [
            (e.name, e.where, e.stage, ", ".join(f"{p.name} ({p.unit})" for p in e.parameters), e.physics)
            for e in chosen
        ]
        table(console(), f"{len(rows)} effects", ("name", "acts on", "changes", "parameters", "physics"), rows, left=5)


def _show(effect: "Effect") -> None:
    out = console()
    out.print(f"{effect.name}: {effect.title}", style="bold")
    for label, text in (
        ("Physics", effect.physics),
        ("Equation", effect.equation),
        ("In the data", effect.mark),
        ("Mistaken for", ", ".join(effect.confused_with) or "nothing"),
        ("Distinguished by", effect.separated_by),
    ):
        out.print(f"  {label}: {text}", soft_wrap=True, markup=False)
    table(
        out,
        "",
        ("parameter", "unit", "low", "high", "off at", "typical", "why these bounds"),
        [
            (
                p.name,
                p.unit,
                f"{p.low:g}",
                f"{p.high:g}",
                "–" if p.off is None else f"{p.off:g}",
                f"{p.typical:g}",
                p.why,
            )
            for p in effect.parameters
        ],
        left=2,
    )
