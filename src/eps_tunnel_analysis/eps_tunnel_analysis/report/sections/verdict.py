# SPDX-License-Identifier: Apache-2.0
"""The verdict in one sentence, and the staircase of error beside the noise floor."""

import math

from eps_tunnel_analysis.diagnose.ball import part_name
from eps_tunnel_analysis.diagnose.diagnose import Diagnosis
from eps_tunnel_analysis.diagnose.rank import NONE, UNKNOWN
from eps_tunnel_analysis.diagnose.verdict import in_words
from eps_tunnel_analysis.report.page import Bar, Block, Figures, Points, Section, Table, Text
from eps_tunnel_analysis.shown import shown_share, shown_value

LISTED = 8  # hypotheses


def verdict(diagnosis: Diagnosis) -> Section:
    """Sentence, probabilities, and what each step did to the error."""
    v = diagnosis.verdict
    names = ["as given", "values refitted"]
    names += [f"with {' and '.join(in_words(name) for name in v.effects)}"] if v.effects else []
    steps = [(name, e, "rad") for name, e in zip(names, (v.given, v.before, v.after), strict=False)]
    steps += [(f"the ball, {name}", e, "m") for name, e in zip(names, v.ball, strict=False)]
    shown = [(name, p) for name, p in v.set.items() if p >= 0.001][:LISTED]
    blocks: list[Block] = [
        Text(v.sentence),
        Table(
            ("hypothesis", "probability", "in the stated set"),
            [(_said(name), Bar(p, f"{p:.1%}"), "yes" if name in v.stated else "") for name, p in shown],
            caption=f"The stated set holds the truth in {v.coverage:.0%} of cases, as calibrated on emulated rigs.",
        ),
        Table(
            ("model", "E (equation 10)", "on samples held out", "alike, k = 1"),
            [
                (name, shown_value(e.error, unit), shown_value(e.held_out, unit), shown_share(e.alikeness))
                for name, e, unit in steps
            ],
            caption="The staircase of error",
            numeric=(1, 2, 3),
        ),
        Figures(
            [
                (
                    f"{math.sqrt(pair[1]):.2f}",
                    f"{part_name(axis)}: misfit over noise floor",
                    f"{math.sqrt(pair[0]):.2f} before; no model goes far below 1",
                    None,
                )
                for axis, pair in v.floor.items()
            ]
        ),
    ]
    if v.notes:
        blocks.append(Points(v.notes))
    return Section("Verdict", blocks)


def _said(name: str) -> str:
    return {NONE: "nothing is missing", UNKNOWN: "something no known effect explains"}.get(name, name)
