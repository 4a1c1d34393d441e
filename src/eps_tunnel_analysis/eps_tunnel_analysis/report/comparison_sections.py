# SPDX-License-Identifier: Apache-2.0
"""Sections on a comparison: how far, the tunnels, over k, where it fails, errors, what was compared."""

import math
import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from urllib.parse import quote

import numpy as np

from eps_tunnel_analysis.compare import JOINTLY, Comparison
from eps_tunnel_analysis.error import SignalError
from eps_tunnel_analysis.outputs import shown_share, shown_times, shown_unit, shown_value
from eps_tunnel_analysis.phases import MEANING, Misfit, channel_of, mean_command, sentences
from eps_tunnel_analysis.report.page import (
    Band,
    Bar,
    Block,
    Chart,
    CommandToCopy,
    Facts,
    Heading,
    KeyFigures,
    KPicker,
    Line,
    Link,
    Pair,
    Points,
    Section,
    Stripes,
    Table,
    Text,
)

LINES = ("real", "sim", "s3", "s4", "s5", "s6")
LISTED_SPANS = 10
LISTED_PHASES = 8  # the others are folded
OTHERS = ("phase", "direction", "amplitude", "other axes", "trial")


def headline(comparison: Comparison, name: str) -> str:
    """The comparison in a sentence: how far `name` is from the rig, in units of the rig's repeat spread."""
    errors = [e for e in comparison.errors if e.samples]
    if not errors:
        return f"{name} cannot be compared: no sample was seen on both sides"
    if any(math.isnan(e.repeat_rms) for e in errors):
        worst = max(errors, key=lambda e: e.rms / e.range if e.range else math.inf)
        return (
            f"{name} is off by {shown_value(worst.rms, worst.unit)} on {worst.signal}; one trial gives no repeat spread"
        )
    worst = max(errors, key=_times)
    if _times(worst) <= 1:
        return f"{name} is as close to the rig as the rig is to itself"
    if not worst.repeat_rms:
        return f"{name} is off by {shown_value(worst.rms, worst.unit)} on {worst.signal}, where the rig repeats exactly"
    return f"{name} is off by {shown_times(_times(worst))} times what the rig itself repeats, most on {worst.signal}"


def _times(error: SignalError) -> float:
    """RMS in units of the repeat spread."""
    if not error.repeat_rms:
        return math.inf if error.rms else 0.0
    return error.rms / error.repeat_rms


def three_numbers(comparison: Comparison, before: Comparison | None = None) -> KeyFigures:
    """Error of the signal that is most off, alikeness, and what the rig reaches against itself."""
    seen = before or comparison
    i, first = seen.most_off, comparison.alikeness[0]
    error, joint = comparison.errors[i], JOINTLY if len(comparison.signals) > 1 else comparison.signals[0]
    was = seen.errors[comparison.signals.index(error.signal)] if before else None
    rig = comparison.against_itself[0].joint if comparison.against_itself else math.nan
    spread = "unknown with one trial" if math.isnan(error.repeat_rms) else shown_value(error.repeat_rms, error.unit)
    too_few = "" if comparison.against_itself else "This needs three trials or more."
    return KeyFigures(
        [
            (
                shown_value(error.command_error, error.unit),
                f"error E of {error.signal}",
                (f"{shown_value(was.command_error, was.unit)} before; " if was else "")
                + f"RMS {shown_value(error.rms, error.unit)}, the rig's repeat spread {spread}",
                None,
            ),
            (
                shown_share(first.joint),
                f"alike, {joint}, k = {first.k_real:g}",
                (f"{shown_share(before.alikeness[0].joint)} before; " if before else "")
                + "share of time that the simulation spends within the spread of the real trials",
                _bar(first.joint),
            ),
            (
                shown_share(rig),
                "the rig against itself",
                too_few
                or "the same for one real trial in the tunnel of the others; a model that reaches it is as close as "
                "another trial",
                _bar(rig),
            ),
        ]
    )


def _bar(share: float) -> float | None:
    return None if math.isnan(share) else share


def at_a_glance(
    comparison: Comparison,
    step: tuple[str, str],
    before: Comparison | None = None,
    words: Sequence[str] = (),
    after: str = "after",
) -> Section:
    """Three numbers, the picture before and after, and what to do next.

    Args:
        step: a sentence and the command to run next, "" where there is none.
        before: the previous model; without it, angle and deviation are shown side by side.
        after: name of the compared model next to `before`.
    """
    i = (before or comparison).most_off
    signal, unit = comparison.signals[i], shown_unit(comparison.real.units[i])[1]
    if before is None:
        charts = (
            (f"{signal}, {unit}", _trajectory(comparison, i)),
            ("relative to the real mean", _deviation(comparison, i)),
        )
    else:
        named = ((f"{signal} before", before), (f"{signal} {after}", comparison))
        both = [(name, _deviation(c, i)) for name, c in named]
        low, high = (f(f(_extent(chart)) for _, chart in both) for f in (min, max))
        pad = 0.06 * ((high - low) or 1.0)
        same = [(name, replace(chart, y_range=(low - pad, high + pad))) for name, chart in both]
        charts = (same[0], same[1])
    blocks: list[Block] = [three_numbers(comparison, before), Pair(charts)]
    blocks += [Points(words)] if words else []
    blocks.append(CommandToCopy(*step) if step[1] else Text(step[0]))
    return Section("At a glance", blocks)


def _extent(chart: Chart) -> tuple[float, float]:
    """Lowest and highest value drawn at k = 1."""
    parts = [line.values for line in chart.lines]
    parts += [chart.band.centre + chart.band.lower, chart.band.centre + chart.band.upper] if chart.band else []
    values = np.concatenate(parts)
    known = values[np.isfinite(values)]
    return (float(known.min()), float(known.max())) if len(known) else (0.0, 0.0)


def summary(comparison: Comparison) -> Section:
    """One card per signal, and the worst in words."""
    first = comparison.alikeness[0]
    rig = comparison.against_itself[0].shares if comparison.against_itself else {}
    cards: list[tuple[str, str, str, float | None]] = []
    for error in comparison.errors:
        share = first.shares[error.signal]
        relation = f"; RMS error {shown_value(error.rms, error.unit)}"
        if error.repeat_rms > 0:
            relation += f", the rig's repeat spread {shown_value(error.repeat_rms, error.unit)}"
        itself = f" (the rig against itself: {shown_share(rig[error.signal])})" if rig else ""
        explained = f"alike at k = {first.k_real:g}{itself}{relation}"
        cards.append((shown_share(share), error.signal, explained, _bar(share)))
    words = sentences(comparison.where) or ("The simulation equals the real mean.",)
    return Section(
        "How far",
        (KeyFigures(cards), Points((*words, *comparison.notes))),
        lead="Alikeness is the share of samples at which the simulation lies inside the tunnel of the repeated real "
        "trials. It can be expected to reach what the rig reaches against itself, one trial in the tunnel of the "
        "others.",
    )


def tunnels(comparison: Comparison) -> Section:
    """Two charts per signal: trajectories, then the deviation from the real mean, time outside shaded."""
    blocks: list[Block] = [KPicker([a.k_real for a in comparison.alikeness])]
    for i, signal in enumerate(comparison.signals):
        blocks += [Heading(signal), _trajectory(comparison, i), _deviation(comparison, i)]
    smoothed = " Its limits are smoothed over 11 samples (equation 12)." if comparison.real_tunnel.smoothed else ""
    return Section(
        "Tunnels",
        blocks,
        lead=f"The band is the tunnel of {comparison.real.count} real trial{'s' * (comparison.real.count > 1)}."
        f"{smoothed} Below, the same relative to the real mean, where the width can be seen. Red marks the time "
        "outside. Drag to zoom, double-click to return; the values at the cursor are shown below.",
    )


def _trajectory(comparison: Comparison, i: int) -> Chart:
    real, sim = comparison.real_tunnel, comparison.sim_tunnel
    factor, unit = shown_unit(real.units[i])
    mean, lower, upper = (factor * a[:, i] for a in (real.mean, real.lower, real.upper))
    lines = [Line("real mean", mean, "real"), Line("simulation", factor * sim.mean[:, i], "sim")]
    channel = channel_of(comparison.signals[i], comparison.real.command_channels)
    if channel is not None and real.units[i] == "rad":
        command = factor * mean_command(comparison.real)[:, comparison.real.command_channels.index(channel)]
        lines.insert(0, Line("command", command, "command", width=1, dash=True, steps=True))
    name = comparison.signals[i]
    return Chart(
        x=real.time, lines=lines, x_label="time in s", y_label=unit, band=Band("tunnel", mean, lower, upper),
        label=f"Tunnel of {name} over time with the simulated trajectory", outside=_outside(comparison, name),
        together="time",
    )  # fmt: skip


def _deviation(comparison: Comparison, i: int) -> Chart:
    real, sim = comparison.real_tunnel, comparison.sim_tunnel
    factor, unit = shown_unit(real.units[i])
    mean, lower, upper = (factor * a[:, i] for a in (real.mean, real.lower, real.upper))
    lines = [Line("simulation − real", factor * sim.mean[:, i] - mean, "sim")]
    if comparison.sim.count > 1:
        for name, edge in zip(("lower", "upper"), sim.bounds(comparison.alikeness[0].k_sim), strict=True):
            lines.append(
                Line(f"simulation's tunnel, {name} edge", factor * edge[:, i] - mean, "sim", width=0.8, dash=True)
            )
    name = comparison.signals[i]
    return Chart(
        x=real.time, lines=lines, x_label="time in s", y_label=f"− real mean, {unit}",
        band=Band("tunnel", np.where(np.isnan(mean), np.nan, 0.0), lower, upper), height=200,
        label=f"Deviation of {name} from the real mean over time", outside=_outside(comparison, name), together="time",
    )  # fmt: skip


def _outside(comparison: Comparison, name: str) -> dict[str, list[tuple[float, float]]]:
    return {f"{a.k_real:g}": [(s.start, s.end) for s in a.spans(name)] for a in comparison.alikeness}


def over_k(comparison: Comparison) -> Section:
    """A line per signal and one for all together; the same as a table, the rig against itself in every row."""
    ks = [a.k_real for a in comparison.alikeness]
    curves, rows = [], []
    for i, curve in enumerate(comparison.curves):
        joint = curve.name == JOINTLY
        curves.append(Line(curve.name, 100 * np.array(curve.shares), "text" if joint else LINES[i % len(LINES)],
                           width=3 if joint else 2, dash=i >= len(LINES), points=True))  # fmt: skip
        rows.append((curve.name, *map(shown_share, curve.shares)))
        rows += [("the rig against itself", *map(shown_share, curve.itself))] if curve.itself else []
    if comparison.against_itself:
        itself = 100 * np.array(comparison.curves[-1].itself)
        curves.append(
            Line(f"the rig against itself, {comparison.curves[-1].name}", itself, "muted", dash=True, points=True)
        )
    unseen = comparison.alikeness[0].unseen
    left_out = ", ".join(f"{n} of {name}" for name, n in unseen.items() if n)
    return Section(
        "Alikeness over k",
        (
            Chart(
                x=np.array(ks), lines=curves, x_label="k, factor on the real tunnel's width", y_label="alikeness in %",
                label="Share of alike samples over the factor k", y_range=(-3, 103),
            ),
            Table(
                ("signal", *(f"k = {k:g}" for k in ks)),
                rows,
                numeric=range(1, len(ks) + 1),
                caption=f"Samples that are missing on one side are left out: {left_out}." if left_out else "",
            ),
        ),
        lead="How much wider the real tunnel would have to be for the simulation to fit. A curve that starts as high "
        "as the rig against itself is a close model; one that rises late is off by several times the rig's own spread.",
    )  # fmt: skip


def where_it_fails(comparison: Comparison) -> Section:
    """Spans as bars over time, then tables with the worst first."""
    spans = comparison.spans
    known = all(m.repeat_rms > 0 for m in comparison.where)
    unit = "repeat spread" if known else "range"
    blocks: list[Block] = [Points(sentences(comparison.where))]
    if spans:
        blocks.append(_bars(comparison))
        blocks.append(_longest(comparison))
    if len(comparison.signals) > 1:
        blocks.append(
            _table([m for m in comparison.where if m.kind == "axis"], f"By axis, in units of each signal's {unit}")
        )
    both = sorted(
        (m for m in comparison.where if m.kind == "phase and direction"),
        key=lambda m: (-m.times if known else -m.error_share, m.signal),
    )
    if both:
        blocks.append(_table(both[:LISTED_PHASES], "By phase and direction of the command, worst first"))
        if both[LISTED_PHASES:]:
            blocks.append(_table(both[LISTED_PHASES:], f"The other {len(both) - LISTED_PHASES} phases", folded=True))
        blocks.append(
            Facts([(name, meaning) for name, meaning in MEANING.items() if any(name in m.group for m in both)])
        )
    for kind in OTHERS:
        rows = [m for m in comparison.where if m.kind == kind]
        if rows and len({m.group for m in rows}) > 1:
            blocks.append(_table(rows, f"By {kind}", folded=True))
    lead = "The simulation stays inside every tunnel." if not spans else (
        f"{len(spans)} span{'s' * (len(spans) > 1)} outside at k = {comparison.alikeness[0].k_real:g}. Look first at "
        "groups with a larger share of the squared error than of the time. The rig's repeat spread is the RMS of its "
        "trials about their mean."
    )  # fmt: skip
    return Section("Where it fails", blocks, lead=lead)


def _bars(comparison: Comparison) -> Stripes:
    rows = [(name, [(s.start, s.end) for s in comparison.spans if s.signal == name]) for name in comparison.signals]
    return Stripes(
        rows,
        start=float(comparison.real.time[0]),
        end=float(comparison.real.time[-1]) + comparison.real.step,
        label="Time spent outside the tunnel, signal by signal",
        caption=f"Time outside the tunnel, k = {comparison.alikeness[0].k_real:g}",
    )


def _longest(comparison: Comparison) -> Table:
    spans = sorted(comparison.spans, key=lambda s: (-s.samples, s.start))
    total = len(comparison.real.time)
    return Table(
        ("signal", "from", "to", "lasting", "share of the run"),
        [
            (
                s.signal,
                f"{s.start:.2f} s",
                f"{s.end:.2f} s",
                f"{s.end - s.start:.2f} s",
                Bar(s.samples / total, f"{s.samples / total:.1%}"),
            )
            for s in spans[:LISTED_SPANS]
        ],
        caption="Longest spans outside" + (f" ({LISTED_SPANS} of {len(spans)})" if len(spans) > LISTED_SPANS else ""),
        numeric=(1, 2, 3),
        folded=True,
    )  # fmt: skip


def _table(rows: list[Misfit], caption: str, folded: bool = False) -> Table:
    return Table(
        ("signal", "where", "share of squared error", "of the time", "simulation − real", "RMS", "in repeat spreads"),
        [
            (
                m.signal,
                m.group,
                Bar(m.error_share, f"{m.error_share:.0%}"),
                f"{m.time_share:.0%}",
                shown_value(m.mean, m.unit),
                shown_value(m.rms, m.unit),
                shown_times(m.times),
            )
            for m in rows
        ],
        caption=caption,
        numeric=(3, 4, 5, 6),
        folded=folded,
    )


def errors(comparison: Comparison) -> Section:
    """Equation 10, RMS, bias and worst, with the rig's own repeat error."""
    rows = [
        (
            e.signal,
            shown_value(e.command_error, e.unit),
            shown_value(e.rms, e.unit),
            shown_share(e.rms / e.range) if e.range else "–",
            shown_value(e.bias, e.unit),
            f"{shown_value(e.worst, e.unit)} at {e.worst_time:.2f} s" if e.samples else "–",
            shown_value(e.repeat_rms, e.unit),
        )
        for e in comparison.errors
    ]
    return Section(
        "Errors",
        (
            Table(
                ("signal", "E (equation 10)", "RMS", "RMS / range", "bias", "worst", "real trials about their mean"),
                rows,
                numeric=range(1, 7),
            ),
        ),
        lead="Simulated mean minus real mean. The last column is the floor: no model comes closer to a single trial.",
    )


def provenance(facts: Sequence[tuple[str, str]], at: Path | None = None) -> Section:
    """Pairs of name and value from the command; a value that begins with a path becomes a link.

    Args:
        at: the folder in which the page will be found; without it there are no links.
    """
    return Section("What was compared", (Facts([(name, linked(value, at)) for name, value in facts]),))


def linked(value: str, at: Path | None) -> str | Link:
    """A path with an optional note in brackets, as a link from the folder `at`; other words are not changed."""
    path, space, rest = value.partition(" (")
    if at is None or not path or ("/" not in path and rest == "") or not Path(path).exists():
        return value
    return Link(path, quote(Path(os.path.relpath(path, at)).as_posix()), space + rest)
