# SPDX-License-Identifier: Apache-2.0
"""The report of one comparison."""

from collections.abc import Callable, Sequence

from eps_tunnel_analysis.compare import Comparison
from eps_tunnel_analysis.report.page import Section, render
from eps_tunnel_analysis.report.sections.errors import errors
from eps_tunnel_analysis.report.sections.over_k import over_k
from eps_tunnel_analysis.report.sections.provenance import provenance
from eps_tunnel_analysis.report.sections.summary import summary
from eps_tunnel_analysis.report.sections.tunnels import tunnels
from eps_tunnel_analysis.report.sections.where_it_fails import where_it_fails

SECTIONS: tuple[Callable[[Comparison], Section], ...] = (summary, tunnels, over_k, where_it_fails, errors)


def compare_report(comparison: Comparison, title: str, subtitle: str, facts: Sequence[tuple[str, str]]) -> str:
    """The page as HTML. `facts` say what was compared: bags, hashes, model, versions."""
    return render(title, subtitle, [*(section(comparison) for section in SECTIONS), provenance(facts)])
