# SPDX-License-Identifier: Apache-2.0
"""Errors of each signal, in the units people read."""

from eps_tunnel_analysis.compare import Comparison
from eps_tunnel_analysis.report.page import Section, Table
from eps_tunnel_analysis.shown import shown_share, shown_value


def errors(comparison: Comparison) -> Section:
    """Equation 10, RMS, bias and worst, beside what the rig itself does not repeat."""
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
