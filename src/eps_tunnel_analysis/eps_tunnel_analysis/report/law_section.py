# SPDX-License-Identifier: Apache-2.0
"""The section on what is missing where no effect explains it: force, variables, formula, what is left."""

import numpy as np

from eps_tunnel_analysis.law.proposal import Proposal
from eps_tunnel_analysis.outputs import shown_number, shown_unit, shown_value
from eps_tunnel_analysis.report.page import Bar, Block, Chart, Line, Section, Table, Text
from labyrinth_sim.trials import Array

LISTED = 6  # variables
DRAWN = 1200  # nodes, at most
OVER = {"curve_angle": "q", "curve_sensor": "q", "curve_speed": "q/s"}  # curves over a position or a speed


def law(proposal: Proposal) -> Section:
    """What one axis lacks as a force over its variables, what shows it better, and the formula or curve proposed."""
    missing, found = proposal.missing, proposal.depends
    rows = [
        (d.variable if d.place == proposal.axis else f"{d.variable} {d.place}",
         shown_value(d.period, proposal.position_unit, 4) + (f", {d.traced}" if d.traced else "") if d.period else "",
         Bar(max(d.share, 0.0), f"{max(d.share, 0.0):.0%} ({max(d.interval[0], 0.0):.0%} to {d.interval[1]:.0%})"),
         "yes" if d.named else "")
        for d in found.dependences[:LISTED]
    ]  # fmt: skip
    blocks: list[Block] = [
        Text(proposal.sentence),
        Table(
            ("variable", "period", "predicts", "more than chance"),
            rows,
            caption="Predicts: share of the misfit in stretches of time that were left out, with a 90 % interval. By "
            f"chance variables that were moved in time predict up to {max(found.chance, 0.0):.0%}.",
        ),
    ]
    angle, speed, force, band, time = (np.concatenate(parts) for parts in _parts(proposal))
    unit = missing.unit
    for over, label in ((angle, "angle"), (speed, "speed"), (time, "time")):
        blocks.append(_points(over, force, band, label, unit, proposal.position_unit))
    if proposal.curve and found.first:
        first, position = found.first, shown_unit(proposal.position_unit)
        by = OVER.get(first.curve.removesuffix("_friction"), "")
        scale, over_unit = (position[0], f", {position[1]}{by[1:]}") if by else (1.0, "")
        size, lacks = position if first.curve == "curve_sensor" else (1.0, unit)
        blocks.append(
            Table(
                (f"{first.variable}{over_unit}", f"missing, {lacks}"),
                [(shown_number(scale * x), shown_number(size * y)) for x, y in proposal.curve],
                numeric=(0, 1),
                caption="What is missing over its variable, without a formula. Friction counts against the motion.",
            )
        )
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
    return Section("What is missing", blocks)


def _parts(proposal: Proposal) -> list[list[Array]]:
    plays = proposal.missing.plays
    every = max(1, sum(len(p.nodes) for p in plays) // DRAWN)
    columns = [(p.at_nodes(p.motion.angle), p.at_nodes(p.motion.speed), p.force, p.band, p.nodes) for p in plays]
    return [[c[i][::every] for c in columns] for i in range(5)]


def _points(over: Array, force: Array, band: Array, label: str, unit: str, position: str) -> Chart:
    factor, size = shown_unit(position)
    units, scale = {"angle": size, "speed": f"{size}/s", "time": "s"}, 1.0 if label == "time" else factor
    order = np.argsort(over, kind="stable")
    line = Line("missing force", force[order], "sim", width=0, spread=band[order])
    return Chart(
        x=scale * over[order],
        lines=[line],
        x_label=f"{label} in {units[label]}",
        y_label=f"missing, {unit}",
        label=f"Missing force over {label}",
    )
