# SPDX-License-Identifier: Apache-2.0
"""Alikeness over k, the paper's tables 2 and 3."""

from typing import Any

from eps_tunnel_analysis.compare import Comparison
from eps_tunnel_analysis.report.page import Chart, Section, Table
from eps_tunnel_analysis.shown import shown_share

LINES = ("var(--real)", "var(--sim)", "var(--s3)", "var(--s4)", "var(--s5)", "var(--s6)")


def over_k(comparison: Comparison) -> Section:
    """A line a signal and one for all together; the same as a table."""
    ks = [a.k_real for a in comparison.alikeness]
    rows = {name: [a.shares[name] for a in comparison.alikeness] for name in comparison.signals}
    data: list[dict[str, Any]] = [
        _line(
            name,
            ks,
            shares,
            {"color": LINES[i % len(LINES)], "width": 2, "dash": "solid" if i < len(LINES) else "dash"},
        )
        for i, (name, shares) in enumerate(rows.items())
    ]
    if len(rows) > 1:
        rows["jointly"] = [a.joint for a in comparison.alikeness]
        data.append(_line("jointly", ks, rows["jointly"], {"color": "var(--text)", "width": 3}))
    unseen = comparison.alikeness[0].unseen
    left_out = ", ".join(f"{n} of {name}" for name, n in unseen.items() if n)
    return Section(
        "Alikeness over k",
        (
            Chart(
                data=data,
                layout={
                    "xaxis": {"title": {"text": "k, factor on the real tunnel's width", "standoff": 4}, "tickvals": ks},
                    "yaxis": {"title": {"text": "alikeness in %", "standoff": 4}, "range": [-3, 103]},
                    "hovermode": "closest",
                },
                label="Share of alike samples over the factor k",
            ),
            Table(
                ("signal", *(f"k = {k:g}" for k in ks)),
                [(name, *(shown_share(s) for s in shares)) for name, shares in rows.items()],
                numeric=range(1, len(ks) + 1),
                caption=f"Samples that one side never saw are left out: {left_out}." if left_out else "",
            ),
        ),
        lead="How much wider the real tunnel would have to be for the simulation to fit. A curve that starts high is a "
        "close model; one that rises late is off by several times what the rig itself varies.",
    )


def _line(name: str, ks: list[float], shares: list[float], style: dict[str, Any]) -> dict[str, Any]:
    return {
        "type": "scatter",
        "mode": "lines+markers",
        "name": name,
        "x": ks,
        "y": [100 * s for s in shares],
        "line": style,
        "hovertemplate": "%{y:.2f} %, k = %{x}",
    }
