# SPDX-License-Identifier: Apache-2.0
"""What a calibration says of itself: beside each value, in the result's file, on the terminal."""

import argparse
import math
import shlex
import sys
from dataclasses import asdict
from datetime import UTC, datetime
from typing import Any

from eps_tunnel_analysis.cli.plays import Recorded
from eps_tunnel_analysis.cli.tables import console, table
from eps_tunnel_analysis.cli.versions import versions
from eps_tunnel_analysis.fit.judge import Score
from eps_tunnel_analysis.fit.study import Calibration
from eps_tunnel_analysis.shown import shown_share, shown_value

KS = (1.0, 2.0, 3.0, 5.0)


def source_of(arguments: argparse.Namespace, recorded: Recorded, result: Calibration) -> str:
    """Where a fitted value comes from, as the model's file says beside it."""
    held = _held_out_error(result)
    return (
        f"calibrate: {arguments.method} on {arguments.fitness}, seed {arguments.seed}, {len(recorded.bags)} "
        f"bag{'s' * (len(recorded.bags) > 1)}, {_today()}, held-out error "
        + (f"{held[1]:.3g} (before {held[0]:.3g})" if held else "none")
        + (", interrupted" if result.interrupted else "")
    )


def _held_out_error(result: Calibration) -> tuple[float, float] | None:
    """Mean of E_C over signals and held-out commands, before and after; None where none were held out."""
    if not result.held_out_after:
        return None
    before, after = (
        sum(s.error for s in scores) / len(scores) for scores in (result.held_out_before, result.held_out_after)
    )
    return before, after


def provenance_of(arguments: argparse.Namespace, recorded: Recorded, result: Calibration) -> dict[str, Any]:
    """How the model's file came about."""
    held = _held_out_error(result)
    return {
        "made_by": "eps-tunnel calibrate",
        "method": arguments.method,
        "fitness": arguments.fitness,
        "seed": arguments.seed,
        "date": _today(),
        "start_from": recorded.model.name,
        "bags": [{"path": str(path), "sha256": digest} for path, digest in recorded.bags],
        "held_out": list(dict.fromkeys(n for fit in result.fits for n in fit.held_out_plays)),
        "held_out_error_before": held[0] if held else None,
        "held_out_error_after": held[1] if held else None,
    }


def content_of(
    arguments: argparse.Namespace, recorded: Recorded, result: Calibration, notes: list[str]
) -> dict[str, Any]:
    """The whole result as plain values."""
    return {
        "called": shlex.join(["eps-tunnel", *sys.argv[1:]]),
        "date": _today(),
        "versions": versions(),
        "model": {"name": recorded.model.name, "file": str(recorded.model.path), "rig": recorded.model.rig.name},
        "bags": [{"path": str(path), "sha256": digest} for path, digest in recorded.bags],
        "plays": [
            {"name": play.name, "sequence_hash": digest, "trials": play.trials.count, "samples": len(play.trials.time)}
            for play, digest in zip(recorded.plays, recorded.hashes, strict=True)
        ],
        "method": arguments.method,
        "fitness": arguments.fitness,
        "seed": arguments.seed,
        "interrupted": result.interrupted,
        "evaluations": sum(fit.evaluations for fit in result.fits),
        "seconds": sum(fit.seconds for fit in result.fits),
        "values": result.values,
        "fits": [{"axis": p.axis, **fit.to_json()} for p, fit in zip(result.parts, result.fits, strict=True)],
        "scores": {
            which: [_score(score) for score in getattr(result, which)]
            for which in ("before", "after", "held_out_before", "held_out_after")
        },
        "warnings": list(result.warnings),
        "notes": notes,
    }


def _score(score: Score) -> dict[str, Any]:
    plain = asdict(score)
    plain["error"] = score.error if score.error < float("inf") else None
    return {**plain, "alikeness": {f"{k:g}": share for k, share in score.alikeness.items()}}


def _today() -> str:
    return datetime.now(UTC).strftime("%Y-%m-%d")


def print_calibration(result: Calibration, notes: list[str]) -> None:
    """Values and errors, before and after, as tables on the terminal."""
    out = console()
    for part, fit in zip(result.parts, result.fits, strict=True):
        scale, unit = (100.0, "%") if fit.fitness == "srg" else (1.0, "rad")
        told = [
            (
                p.name,
                f"{p.start:.5g}",
                f"{p.value:.5g}",
                "–" if math.isnan(p.half_width) else f"± {p.half_width:.2g}",
                p.unit,
                "at its bound" if p.at_bound else "",
            )
            for p in fit.parameters
        ]
        table(
            out,
            f"Parameters{f' of axis {part.axis}' if part.axis else ''}: {fit.method}, {fit.evaluations} evaluations, "
            f"{fit.seconds:.1f} s, fitness {scale * fit.before:.4g} -> {scale * fit.after:.4g} {unit}",
            ("parameter", "before", "after", "95 %", "unit", ""),
            told,
        )
    _print_scores(out, "Fitted commands", result.before, result.after)
    _print_scores(out, "Held-out commands", result.held_out_before, result.held_out_after)
    for text in result.warnings:
        out.print(f"Warning: {text}", soft_wrap=True, markup=False)
    for note in notes:
        out.print(f"Note: {note}", soft_wrap=True, markup=False)


def _print_scores(out: Any, title: str, before: tuple[Score, ...], after: tuple[Score, ...]) -> None:
    if not after:
        return
    rows = [
        (
            b.signal,
            shown_value(b.error, b.unit),
            shown_value(a.error, a.unit),
            *(f"{shown_share(b.alikeness[k])} -> {shown_share(a.alikeness[k])}" for k in KS),
        )
        for b, a in zip(before, after, strict=True)
    ]
    table(
        out, f"{title}, before and after", ("signal", "E before", "E after", *(f"alike, k = {k:g}" for k in KS)), rows
    )
