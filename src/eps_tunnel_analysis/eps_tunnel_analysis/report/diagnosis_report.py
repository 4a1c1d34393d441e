# SPDX-License-Identifier: Apache-2.0
"""The report of one diagnosis."""

from collections.abc import Sequence

from eps_tunnel_analysis.diagnose.diagnose import Diagnosis
from eps_tunnel_analysis.report.page import render
from eps_tunnel_analysis.report.sections.evidence import evidence
from eps_tunnel_analysis.report.sections.provenance import provenance
from eps_tunnel_analysis.report.sections.ranking import ranking
from eps_tunnel_analysis.report.sections.tunnels import tunnels
from eps_tunnel_analysis.report.sections.verdict import verdict
from eps_tunnel_analysis.report.sections.what_to_do import what_to_do
from eps_tunnel_analysis.report.sections.where_it_fails import where_it_fails


def diagnosis_report(
    diagnosis: Diagnosis, title: str, subtitle: str, add: str, facts: Sequence[tuple[str, str]]
) -> str:
    """The page as HTML. `add` is the command line that adds what is named; `facts` say what was diagnosed."""
    sections = [
        verdict(diagnosis),
        where_it_fails(diagnosis.before),
        ranking(diagnosis),
        evidence(diagnosis),
        what_to_do(diagnosis, add),
        tunnels(diagnosis.after),
        provenance(facts),
    ]
    return render(title, subtitle, sections)
