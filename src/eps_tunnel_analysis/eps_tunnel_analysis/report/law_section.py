# SPDX-License-Identifier: Apache-2.0
"""What is missing where no effect explains it: force, variables, formula, remaining error, and drawings."""

from collections.abc import Mapping, Sequence

import numpy as np

from eps_tunnel_analysis.diagnose.added_force import Motion
from eps_tunnel_analysis.law.missing_force import MissingForce
from eps_tunnel_analysis.law.proposal import Proposal
from eps_tunnel_analysis.outputs import shown_number, shown_unit, shown_value
from eps_tunnel_analysis.report.page import Bar, Block, Chart, Line, Section, Table, Text
from labyrinth_sim.trials import Array

VARIABLES_LISTED = 6  # variables
DRAWN = 700  # nodes, at most
WIDEST = 3.0  # times the largest value of a curve that its band is drawn to
OVER: Mapping[str, tuple[str, str]] = {
    "angle": ("angle", "q"),
    "speed": ("speed", "q/s"),
    "direction": ("direction", ""),
    "load": ("load", "F"),
    "command": ("command", "q"),
    "other": ("the other axis's angle", "rad"),
    "since": ("time since reversal", "s"),
    "time": ("time", "s"),
}
"""Field of a motion -> its name, and its SI unit, q and F standing for those of the axis's position and force."""


def law(proposal: Proposal) -> Section:
    """What one axis lacks, as a force over its variables, the command that shows it better, and the proposed formula or
    curve."""
    missing, depends = proposal.missing, proposal.depends
    rows = [
        (d.variable if d.acts == (proposal.axis, "force") else f"{d.variable} {d.place}",
         shown_value(d.period, proposal.position_unit, 4) + (f", {d.traced}" if d.traced else "") if d.period else "",
         Bar(max(d.share, 0.0), f"{max(d.share, 0.0):.0%} ({max(d.interval[0], 0.0):.0%} to {d.interval[1]:.0%})"),
         f"{max(d.chance, 0.0):.0%}",
         "yes" if d.named else "")
        for d in depends.dependences[:VARIABLES_LISTED]
    ]  # fmt: skip
    blocks: list[Block] = [
        Text(proposal.sentence),
        Table(
            ("variable", "period", "predicts", "chance", "more than chance"),
            rows,
            numeric=(3,),
            caption="Predicts: share of the misfit in held-out stretches of time, with a 90 % interval. Chance: what "
            "the same variable predicts shifted in time.",
        ),
    ]
    blocks += [*_forces(missing, proposal.position_unit), *_trials(proposal)]
    blocks += _curve(proposal)
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
    blocks += [*_left(proposal), *_others(proposal)]
    return Section("What is missing", blocks)


def _forces(missing: MissingForce, position: str) -> list[Chart]:
    """The force over each variable, with its standard deviation and the model's own, the drive's, for scale.

    Args:
        position: SI unit of the axis's position.
    """
    charts = []
    force, band, own = (_joined(missing, values) for values in ("force", "band", "drive"))
    for name, (label, unit) in OVER.items():
        if all(getattr(p.motion, name).size for p in missing.plays):
            factor, size = shown_unit(unit.replace("q", position).replace("F", missing.unit))
            lines = [("missing force", force, "sim", band), ("the drive's force in the model", own, "muted", None)]
            over = factor * _joined(missing, name)
            what = f"{label} in {size}" if size else label
            charts.append(_points(over, lines, what, f"missing, {missing.unit}", f"Missing force over {label}"))
    return charts


def _curve(proposal: Proposal) -> list[Block]:
    """What is missing over the variable named, without a formula, with its band."""
    if not proposal.curve or proposal.depends.first is None:
        return []
    (by, over), (times, unit) = (shown_unit(u) for u in proposal.curve_units)
    x, y = np.array(proposal.curve).T
    most = WIDEST * float(np.abs(y).max())
    band = np.minimum(np.array(proposal.curve_band), most) if proposal.curve_band else np.zeros(len(y))
    first = proposal.depends.first
    name = "angle" if first.constant else first.variable
    if first.pair:
        name = name.partition(" and ")[0]
    rows = [
        (shown_number(by * a), f"{shown_number(times * b)} ± {shown_number(times * c, 2)}")
        for (a, b), c in zip(proposal.curve, band, strict=True)
    ]
    line = Line("missing", times * y, "sim", points=True, spread=times * band)
    label = f"What is missing over {name}, without a formula"
    return [
        Chart(by * x, [line], f"{name} in {over}" if over else name, f"missing, {unit}", label,
              "With the 90 % interval. Friction is counted against the motion."),
        Table((f"{name}, {over}" if over else name, f"missing, {unit}"), rows, numeric=(0, 1), folded=True,
              caption="What is missing over its variable, without a formula. Friction is counted against the motion."),
    ]  # fmt: skip


def _left(proposal: Proposal) -> list[Block]:
    """The missing force with and without the proposal, over time."""
    after = proposal.left
    if after is None:
        return []
    before = proposal.missing
    lines = [("without the proposal", _joined(before, "force"), "muted", None),
             ("with it", _joined(after, "force"), "sim", _joined(after, "band"))]  # fmt: skip
    return [_points(_joined(before, "time"), lines, "time in s", f"missing, {before.unit}", "What is left over time")]


def _trials(proposal: Proposal) -> list[Block]:
    """By how much each trial differs from the others of its play."""
    blocks: list[Block] = []
    for name, rows in proposal.trials.items():
        if len(rows) > 1:
            factor, unit = shown_unit(proposal.position_unit)
            line = Line(name, factor * rows[:, 1], "sim", width=0, points=True)
            label = f"{name}: how trials differ, over their number"
            blocks.append(Chart(rows[:, 0], [line], "number of the trial", f"{name}, {unit}", label))
    return blocks


def _others(proposal: Proposal) -> list[Block]:
    """What else is missing: behind an elastic belt, on other axes, or by sensors alone."""
    rows, blocks = [], list[Block]()
    for missing in proposal.also:
        what = f"force on axis {missing.axis}, {missing.side}'s side"
        rows.append((what, shown_value(missing.size, missing.unit), *_floors(missing.floors)))
        lines = [("missing force", _joined(missing, "force"), "sim", _joined(missing, "band"))]
        time = _joined(missing, "time")
        blocks.append(_points(time, lines, "time in s", f"missing, {missing.unit}", f"Missing {what}"))
    for offset in proposal.offsets:
        factor, unit = shown_unit(offset.unit)
        time, values, band = (np.concatenate(part) for part in (offset.time, offset.offset, offset.band))
        what = f"offset of {offset.signal}, if it alone were wrong"
        size = float(np.sqrt(np.mean(values**2)))
        rows.append((what, shown_value(size, offset.unit), *_floors(offset.floors)))
        lines = [("missing offset", factor * values, "sim", factor * band)]
        blocks.append(_points(time, lines, "time in s", f"missing, {unit}", f"Missing {what}"))
    if not rows:
        return []
    columns = ("what", "root mean square", "floors without it", "with it, fitted freely over time")
    return [Table(columns, rows, numeric=(1, 2, 3)), *blocks]


def _floors(floors: tuple[float, float]) -> tuple[str, str]:
    return shown_number(floors[0]), shown_number(floors[1])


def _joined(missing: MissingForce, name: str) -> Array:
    """(n,) at the nodes of all plays: the force, its band, or the named quantity of the motion."""
    if name in ("force", "band"):
        return np.concatenate([np.asarray(getattr(p, name)) for p in missing.plays])
    return np.concatenate([p.at_nodes(_of(p.motion, name)) for p in missing.plays])


def _of(motion: Motion, name: str) -> Array:
    values: Array = getattr(motion, name)
    return values


def _points(
    over: Array, lines: Sequence[tuple[str, Array, str, Array | None]], x_label: str, y_label: str, label: str
) -> Chart:
    """Points over a variable in rising order, without unknown ones; thinned."""
    order = np.argsort(over, kind="stable")
    order = order[np.isfinite(over[order])]
    order = order[:: max(1, -(-len(order) // DRAWN))]
    drawn = [Line(name, values[order], colour, width=0, spread=None if band is None else band[order])
             for name, values, colour, band in lines]  # fmt: skip
    return Chart(over[order], drawn, x_label, y_label, label)
