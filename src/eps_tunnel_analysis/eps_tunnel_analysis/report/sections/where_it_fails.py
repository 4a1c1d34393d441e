# SPDX-License-Identifier: Apache-2.0
"""Where the model fails: time outside the tunnels, and the misfit over phases, directions, amplitudes, axes, trials."""

from eps_tunnel_analysis.compare import Comparison
from eps_tunnel_analysis.phases import MEANING
from eps_tunnel_analysis.report.page import Bar, Block, Chart, Facts, Section, Table
from eps_tunnel_analysis.shown import shown_value
from eps_tunnel_analysis.where import Misfit

LONGEST = 10  # spans listed
OTHERS = ("phase", "direction", "amplitude", "other axes", "trial")


def where_it_fails(comparison: Comparison) -> Section:
    """Spans as bars over time, then tables with the worst first."""
    spans = comparison.spans
    blocks: list[Block] = []
    if spans:
        blocks.append(_bars(comparison))
        blocks.append(_longest(comparison))
    if len(comparison.signals) > 1:
        blocks.append(
            _table([m for m in comparison.where if m.kind == "axis"], "By axis, relative to each signal's range")
        )
    both = sorted(
        (m for m in comparison.where if m.kind == "phase and direction"), key=lambda m: (-m.error_share, m.signal)
    )
    if both:
        blocks.append(_table(both, "By phase and direction of the command"))
        blocks.append(
            Facts([(name, meaning) for name, meaning in MEANING.items() if any(name in m.group for m in both)])
        )
    for kind in OTHERS:
        rows = [m for m in comparison.where if m.kind == kind]
        if rows and len({m.group for m in rows}) > 1:
            blocks.append(_table(rows, f"By {kind}", folded=True))
    lead = "The simulation stays inside every tunnel." if not spans else (
        f"{len(spans)} span{'s' * (len(spans) > 1)} outside at k = {comparison.alikeness[0].k_real:g}. A group with a "
        "larger share of the squared error than of the time is where to look."
    )  # fmt: skip
    return Section("Where it fails", blocks, lead=lead)


def _bars(comparison: Comparison) -> Chart:
    names = list(comparison.signals)
    data = [
        {
            "type": "bar",
            "orientation": "h",
            "showlegend": False,
            "y": [s.signal for s in comparison.spans],
            "x": [s.end - s.start for s in comparison.spans],
            "base": [s.start for s in comparison.spans],
            "customdata": [s.end for s in comparison.spans],
            "marker": {"color": "var(--sim)"},
            "hovertemplate": "%{base:.2f} to %{customdata:.2f} s<extra></extra>",
        }
    ]
    end = float(comparison.real.time[-1]) + comparison.real.step
    return Chart(
        data=data,
        layout={
            "xaxis": {"title": {"text": "time in s", "standoff": 4}, "range": [float(comparison.real.time[0]), end]},
            "yaxis": {"categoryorder": "array", "categoryarray": names[::-1], "range": [-0.5, len(names) - 0.5]},
            "bargap": 0.45,
            "barmode": "overlay",
            "hovermode": "closest",
        },
        label="Time spent outside the tunnel, signal by signal",
        caption=f"Time outside the tunnel, k = {comparison.alikeness[0].k_real:g}",
        height=90 + 42 * len(names),
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
            for s in spans[:LONGEST]
        ],
        caption="Longest spans outside" + (f" ({LONGEST} of {len(spans)})" if len(spans) > LONGEST else ""),
        numeric=(1, 2, 3),
        folded=True,
    )  # fmt: skip


def _table(rows: list[Misfit], caption: str, folded: bool = False) -> Table:
    return Table(
        ("signal", "where", "share of squared error", "of the time", "simulation − real", "RMS"),
        [
            (
                m.signal,
                m.group,
                Bar(m.error_share, f"{m.error_share:.0%}"),
                f"{m.time_share:.0%}",
                shown_value(m.mean, m.unit),
                shown_value(m.rms, m.unit),
            )
            for m in rows
        ],
        caption=caption,
        numeric=(3, 4, 5),
        folded=folded,
    )
