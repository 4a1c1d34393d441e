# SPDX-License-Identifier: Apache-2.0
"""What was compared: recordings, model, settings, versions."""

from collections.abc import Sequence

from eps_tunnel_analysis.report.page import Facts, Section


def provenance(facts: Sequence[tuple[str, str]]) -> Section:
    """Pairs of name and value, as the command gathered them."""
    return Section("What was compared", (Facts(facts),))
