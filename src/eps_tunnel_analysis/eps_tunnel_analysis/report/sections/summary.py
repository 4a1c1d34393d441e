# SPDX-License-Identifier: Apache-2.0
"""How far: the alikeness and the errors in a few large figures."""

import math

from eps_tunnel_analysis.compare import Comparison
from eps_tunnel_analysis.report.page import Figures, Points, Section
from eps_tunnel_analysis.shown import shown_share, shown_value
from eps_tunnel_analysis.where import sentences


def summary(comparison: Comparison) -> Section:
    """The number, one card a signal, and the worst in words."""
    first = comparison.alikeness[0]
    cards: list[tuple[str, str, str, float | None]] = []
    if len(comparison.signals) > 1:
        cards.append(
            (
                shown_share(first.joint),
                "alike in every signal at once",
                f"share of samples inside all tunnels, k = {first.k_real:g}",
                None if math.isnan(first.joint) else first.joint,
            )
        )
    for error in comparison.errors:
        share = first.shares[error.signal]
        relation = ""
        if error.repeat_rms > 0:
            relation = f"; the rig repeats itself within {shown_value(error.repeat_rms, error.unit)}"
        cards.append(
            (
                shown_share(share),
                error.signal,
                f"alike at k = {first.k_real:g}; RMS error {shown_value(error.rms, error.unit)}{relation}",
                None if math.isnan(share) else share,
            )
        )
    words = sentences(comparison.where) or ("The simulation equals the real mean.",)
    return Section(
        "How far",
        (Figures(cards), Points((*words, *comparison.notes))),
        lead="Alikeness is the share of samples at which the simulation lies inside the tunnel of the repeated real "
        "trials. 100 % is alike everywhere; a small share is a large gap.",
    )
