# SPDX-License-Identifier: Apache-2.0
"""The files of one comparison: report, JSON, CSV and pictures."""

import csv
import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from eps_tunnel_analysis.compare import Comparison
from eps_tunnel_analysis.report.compare_report import compare_report
from eps_tunnel_analysis.report.pictures import write_pictures


def write_comparison(
    folder: Path, comparison: Comparison, content: Mapping[str, Any], title: str, facts: Sequence[tuple[str, str]],
    pictures: bool = True,
) -> None:  # fmt: skip
    """Writes into an existing, empty folder.

    Args:
        content: what compare.json holds, at least `comparison.to_json()`.
        facts: what was compared, for the end of the report.
        pictures: as files, too; they take some seconds.
    """
    trials, names = comparison.real.count, comparison.signals
    seconds = comparison.real.time[-1] + comparison.real.step
    subtitle = f"{trials} real trial{'s' * (trials > 1)}, {', '.join(names)}, {seconds:.1f} s"
    page = compare_report(comparison, title, subtitle, facts)
    (folder / "report.html").write_text(page, encoding="utf-8")
    (folder / "compare.json").write_text(json.dumps(content, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    shares = ((a.k_real, *(a.shares[n] for n in names), a.joint) for a in comparison.alikeness)
    _csv(folder / "alikeness.csv", ("k", *names, "jointly"), shares)
    for file in ("errors", "where", "spans"):
        rows = content[file]
        _csv(folder / f"{file}.csv", tuple(rows[0]) if rows else ("signal",), (tuple(row.values()) for row in rows))
    _csv(folder / "tunnel.csv", *_tunnel(comparison))
    if pictures:
        write_pictures(comparison, folder)


def _tunnel(comparison: Comparison) -> tuple[Sequence[str], Iterable[Sequence[float]]]:
    """Header and rows in SI units, one a sample."""
    real, sim = comparison.real_tunnel, comparison.sim_tunnel
    columns = {
        "mean": real.mean,
        "lower": real.lower,
        "upper": real.upper,
        "sim": sim.mean,
        "sim_lower": sim.lower,
        "sim_upper": sim.upper,
    }
    header = ["time", *(f"{name}_{what}" for name in comparison.signals for what in columns)]
    signals = range(len(comparison.signals))
    rows = ((t, *(a[n, i] for i in signals for a in columns.values())) for n, t in enumerate(real.time))
    return header, rows


def _csv(path: Path, header: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    with path.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        writer.writerow(header)
        writer.writerows(rows)
