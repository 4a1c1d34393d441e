# SPDX-License-Identifier: Apache-2.0
"""Every candidate that was refitted: what it explains and what it costs."""

from eps_tunnel_analysis.diagnose.ball import part_name
from eps_tunnel_analysis.diagnose.diagnose import Diagnosis
from eps_tunnel_analysis.report.page import Bar, Block, Facts, Heading, Section, Table, Text
from labyrinth_sim.effect import effects as library_effects

LISTED = 12


def ranking(diagnosis: Diagnosis) -> Section:
    """One table an axis, most probable first; then what the best could be mistaken for."""
    blocks: list[Block] = []
    for axis in diagnosis.axes:
        blocks.append(Heading(part_name(axis.part.axis).capitalize()))
        if not axis.refits:
            blocks.append(Text("The model with refitted values is within the noise; no candidate was tried."))
            continue
        rows = []
        for r in axis.ranking[:LISTED]:
            share = max(r.explained, 0.0)
            rows.append((r.name, f"{r.probability:.1%}", Bar(share, f"{share:.1%}"), f"{r.overall:.2f}",
                         f"{r.held_out:.2f}", f"{r.penalty:.1f}"))  # fmt: skip
        blocks.append(
            Table(
                ("hypothesis", "probability", "explains", "misfit left", "on held-out samples", "pays"),
                rows,
                numeric=(1, 3, 4, 5),
                caption="Misfit: mean square in units of the noise floor. Pays: penalty in log-likelihood for its "
                "values and for having been chosen from many.",
            )
        )
    known = library_effects()
    facts = []
    for name in diagnosis.verdict.effects:
        effect = known[name.partition(".")[0]]
        facts += [
            (name, effect.physics),
            ("what it looks like", effect.mark),
            ("could be mistaken for", ", ".join(effect.confused_with)),
            ("told apart by", effect.separated_by),
        ]
    if facts:
        blocks.append(Facts(facts))
    return Section(
        "Why", blocks, lead="Each candidate was refitted together with the drive's values in full roll-outs."
    )
