# SPDX-License-Identifier: Apache-2.0
"""The section on what is missing where no effect explains it: force, variables, formula, remaining error."""

from eps_tunnel_analysis.law.proposal import Proposal
from eps_tunnel_analysis.outputs import shown_number, shown_value
from eps_tunnel_analysis.report import law_charts
from eps_tunnel_analysis.report.page import Bar, Block, Section, Table, Text

LISTED = 6  # variables


def law(proposal: Proposal) -> Section:
    """What one axis lacks, as a force over its variables, the command that shows it better, and the proposed formula or
    curve."""
    missing, depends = proposal.missing, proposal.depends
    rows = [
        (d.variable if d.place == proposal.axis else f"{d.variable} {d.place}",
         shown_value(d.period, proposal.position_unit, 4) + (f", {d.traced}" if d.traced else "") if d.period else "",
         Bar(max(d.share, 0.0), f"{max(d.share, 0.0):.0%} ({max(d.interval[0], 0.0):.0%} to {d.interval[1]:.0%})"),
         "yes" if d.named else "")
        for d in depends.dependences[:LISTED]
    ]  # fmt: skip
    blocks: list[Block] = [
        Text(proposal.sentence),
        Table(
            ("variable", "period", "predicts", "more than chance"),
            rows,
            caption="Predicts: share of the misfit in held-out stretches of time, with a 90 % interval. By "
            f"chance, variables that were shifted in time predict up to {max(depends.chance, 0.0):.0%}.",
        ),
    ]
    blocks += [*law_charts.forces(missing, proposal.position_unit), *law_charts.trials(proposal)]
    blocks += law_charts.curve(proposal)
    if proposal.visit:
        blocks.append(Text(f"To see more of it, play {proposal.visit.name}.yaml. {proposal.visit.reason}"))
    if proposal.refit:
        known = proposal.model.parameters() if proposal.model else {}
        units = {name: known[name].unit if name in known else "1" for name in proposal.refit.values}
        half = proposal.refit.intervals
        blocks.append(
            Table(
                ("number", "value"),
                [(name, f"{shown_value(value, units[name], 4)} ± {shown_value(half.get(name, 0.0), units[name], 2)}")
                 for name, value in proposal.refit.values.items()],
                numeric=(1,),
                caption=f"{proposal.equation}: {shown_number(proposal.base_held_out)} floors without it, "
                f"{shown_number(proposal.refit.held_out)} with it, where left out.",
            )
        )  # fmt: skip
    if len(proposal.tried) > 1:
        blocks.append(
            Table(
                ("terms, refitted in roll-outs", "floors left on held-out data"),
                [(form, shown_number(floors)) for form, floors in proposal.tried.items()],
                numeric=(1,),
            )
        )
    blocks += [*law_charts.left(proposal), *law_charts.others(proposal)]
    return Section("What is missing", blocks)
