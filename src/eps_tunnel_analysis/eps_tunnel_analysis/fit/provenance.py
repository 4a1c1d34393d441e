# SPDX-License-Identifier: Apache-2.0
"""How a calibration came about: beside each value, in the model's file, in the result's file."""

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from eps_tunnel_analysis.fit.calibrate import CalibrationResult, Score, Settings
from eps_tunnel_analysis.inputs import Recorded
from eps_tunnel_analysis.outputs import called, today, versions


def source_of(settings: Settings, recorded: Recorded, result: CalibrationResult) -> str:
    """Where a fitted value comes from, as the model's file says beside it."""
    held = _held_out_error(result)
    return (
        f"calibrate: {settings.optimiser().name} on {settings.fitness}, seed {settings.seed}, {len(recorded.bags)} "
        f"bag{'s' * (len(recorded.bags) > 1)}, {today()}, held-out error "
        + (f"{held[1]:.3g} (before {held[0]:.3g})" if held else "none")
        + (", interrupted" if result.interrupted else "")
    )


def provenance_of(settings: Settings, recorded: Recorded, result: CalibrationResult) -> dict[str, Any]:
    """How the model's file came about."""
    held = _held_out_error(result)
    return {
        "made_by": "eps-tunnel calibrate",
        "method": settings.optimiser().name,
        "fitness": settings.fitness,
        "seed": settings.seed,
        "date": today(),
        "start_from": recorded.model.name,
        "bags": [{"path": str(path), "sha256": digest} for path, digest in recorded.bags],
        "held_out": list(dict.fromkeys(n for fit in result.fits for n in fit.held_out_plays)),
        "held_out_error_before": held[0] if held else None,
        "held_out_error_after": held[1] if held else None,
    }


def content_of(
    settings: Settings, recorded: Recorded, result: CalibrationResult, notes: Sequence[str]
) -> dict[str, Any]:
    """The whole result; an error of a simulation that diverged is infinite."""
    return {
        "called": called(),
        "date": today(),
        "versions": versions(),
        "model": {"name": recorded.model.name, "file": str(recorded.model.path), "rig": recorded.model.rig.name},
        "bags": [{"path": str(path), "sha256": digest} for path, digest in recorded.bags],
        "plays": [
            {"name": play.name, "sequence_hash": digest, "trials": play.trials.count, "samples": len(play.trials.time)}
            for play, digest in zip(recorded.plays, recorded.hashes, strict=True)
        ],
        "method": settings.optimiser().name,
        "fitness": settings.fitness,
        "seed": settings.seed,
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
        "notes": list(notes),
    }


def _held_out_error(result: CalibrationResult) -> tuple[float, float] | None:
    """Mean of E_C over signals and held-out commands, before and after; None where none were held out."""
    if not result.held_out_after:
        return None
    before, after = (
        sum(s.error for s in scores) / len(scores) for scores in (result.held_out_before, result.held_out_after)
    )
    return before, after


def _score(score: Score) -> dict[str, Any]:
    return {**asdict(score), "alikeness": {f"{k:g}": share for k, share in score.alikeness.items()}}
