# SPDX-License-Identifier: Apache-2.0
"""The report of one walk through the loop: the gap, the reason, and the gap once the model was changed."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from eps_tunnel_analysis.compare import Comparison
from eps_tunnel_analysis.diagnose.diagnose import Diagnosis
from eps_tunnel_analysis.report.page import Block, Chart, Section, Table, Text, render
from eps_tunnel_analysis.report.sections.evidence import evidence
from eps_tunnel_analysis.report.sections.provenance import provenance
from eps_tunnel_analysis.report.sections.tunnels import tunnels
from eps_tunnel_analysis.report.sections.verdict import verdict
from eps_tunnel_analysis.report.sections.where_it_fails import where_it_fails
from eps_tunnel_analysis.shown import shown_share, shown_value


def before_after(before: Comparison, after: Comparison) -> list[tuple[str, str, str]]:
    """Rows of (what, before, after): E of each signal that both have (equation 10), and the joint alikeness by k."""
    old, new = ({e.signal: e for e in c.errors} for c in (before, after))
    rows = [
        (f"error E of {s}", shown_value(e.command_error, e.unit), shown_value(new[s].command_error, e.unit))
        for s, e in old.items()
        if s in new
    ]
    shares = zip(before.alikeness, after.alikeness, strict=True)
    return rows + [(f"alike in every signal, k = {a.k_real:g}", shown_share(a.joint), shown_share(b.joint))
                   for a, b in shares]  # fmt: skip


def loop_report(
    before: Comparison, diagnosis: Diagnosis, after: Comparison, sentences: Sequence[str],
    facts: Sequence[tuple[str, str]],
) -> str:  # fmt: skip
    """The page as HTML. `sentences` tell the walk and its end; `facts` say where everything is."""
    loop: list[Block] = [
        *map(Text, sentences),
        Table(
            ("", "before", "after"),
            before_after(before, after),
            caption=f"Each from {before.real.count} and {after.real.count} trials that were played on both sides.",
            numeric=(1, 2),
        ),
        _over_k(before, after),
    ]
    sections = [
        Section("The loop", loop),
        replace(where_it_fails(before), title="Where it failed"),
        replace(verdict(diagnosis), title="Why"),
        evidence(diagnosis),
        replace(tunnels(after), title="The gap afterwards"),
        provenance(facts),
    ]
    trials = before.real.count + after.real.count
    return render("From the gap to its reason", f"{trials} real trials, {', '.join(before.signals)}", sections)


def _over_k(before: Comparison, after: Comparison) -> Chart:
    data: list[dict[str, Any]] = [
        {
            "type": "scatter",
            "mode": "lines+markers",
            "name": name,
            "x": [a.k_real for a in c.alikeness],
            "y": [100 * a.joint for a in c.alikeness],
            "line": {"color": colour, "width": 2},
            "hovertemplate": "%{y:.2f} %, k = %{x}",
        }
        for name, c, colour in (("before", before, "var(--sim)"), ("after", after, "var(--real)"))
    ]
    return Chart(
        data=data,
        layout={
            "xaxis": {"title": {"text": "k, factor on the real tunnel's width", "standoff": 4}},
            "yaxis": {"title": {"text": "alikeness in %", "standoff": 4}, "range": [-3, 103]},
            "hovermode": "closest",
        },
        label="Share of samples alike in every signal over k, before and after",
    )
