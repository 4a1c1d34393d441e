# SPDX-License-Identifier: Apache-2.0
"""A fit to recordings, and its two files: the model, and the full result next to it."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from eps_tunnel_analysis.calibration.calibrate import Bars, CalibrationResult, Score, Settings, calibrate_model
from eps_tunnel_analysis.calibration.validity import validity_of
from eps_tunnel_analysis.error import mean_error
from eps_tunnel_analysis.fit.problem import default_free, free_parameters
from eps_tunnel_analysis.inputs import Recorded
from eps_tunnel_analysis.outputs import called, json_text, model_file, refuse_files, today, versions
from labyrinth_sim.model import Model, save_model
from labyrinth_sim.shown import shown
from labyrinth_sim.whole_file import beside, folder_of, write_new


@shown
@dataclass(frozen=True)
class Calibration:
    """A fit, its messages, the content of its .fit.json, and the model with the sources of its values."""

    result: CalibrationResult
    notes: tuple[str, ...]
    content: dict[str, Any]
    model: Model


def model_and_result(out: Path) -> tuple[Path, Path]:
    """The files of the model and of the result, before the work starts.

    Raises:
        InputError: either exists.
        OSError: their folder cannot be made or written.
    """
    out = model_file(out)
    result = out.with_suffix(".fit.json")
    refuse_files(out, result)
    with suppress(_Tried), folder_of(out), beside(out):
        raise _Tried
    return out, result


class _Tried(Exception):
    """A file was made where the model will be, and is removed again."""


def calibrate_bags(
    recorded: Recorded, free: Sequence[Any], settings: Settings, axis_by_axis: bool, files: tuple[Path, Path], bars: Any
) -> Calibration:
    """Fits, and writes both files of `model_and_result`.

    Args:
        free, settings, axis_by_axis, bars: as in `calibrate_model`.

    Raises:
        InputError: what `calibrate_model` raises.
    """
    return write_calibration(calibrate_recorded(recorded, free, settings, axis_by_axis, bars), files)


def free_of(recorded: Recorded, patterns: Sequence[str] = (), signals: Sequence[str] = ()) -> tuple[str, ...]:
    """Full names of the values to fit: those that match `patterns`; without any, what the model's drives and effects
    declare as free and is not given as known for the recordings.

    Args:
        signals: that are compared.

    Raises:
        InputError: a pattern that matches nothing.
    """
    if patterns:
        return free_parameters(recorded.model, patterns)
    known = {name for play in recorded.plays for name in play.known}
    return tuple(name for name in default_free(recorded.model, signals=signals) if name not in known)


def calibrate_recorded(
    recorded: Recorded, free: Sequence[str], settings: Settings, axis_by_axis: bool = False, bars: Bars | None = None
) -> Calibration:
    """Fits what was read by `load_recorded`, and writes nothing; arguments and errors as in `calibrate_model`."""
    result = calibrate_model(recorded.model, recorded.plays, free, settings, axis_by_axis, bars)
    notes = list(recorded.notes)
    if not settings.held_out:
        count = len(recorded.plays)
        notes.append(
            f"Nothing was held out of {count} command{'s' * (count > 1)}: the errors are those of the data "
            "that was fitted. Record at least five commands, or name a number with --hold-out."
        )
    signed = result.signed(source_of(settings, recorded, result), provenance_of(settings, recorded, result))
    kept = [play for number, play in enumerate(recorded.plays) if number not in settings.held_out]
    held = [play for number, play in enumerate(recorded.plays) if number in settings.held_out]
    signed = replace(signed, path=None, valid=validity_of(signed, kept, held, recorded.bags))
    return Calibration(result, tuple(notes), content_of(settings, recorded, result, notes), signed)


def write_calibration(calibration: Calibration, files: tuple[Path, Path]) -> Calibration:
    """Writes both files of `model_and_result`; the content then names them. Raises InputError: either exists."""
    out, beside_it = files
    content = {"command": "calibrate", "out": str(out), **calibration.content}
    # The result first: it holds the values too, in case the other file cannot be written.
    write_new(beside_it, json_text(content))
    save_model(calibration.model, out)
    return replace(calibration, content=content)


def source_of(settings: Settings, recorded: Recorded, result: CalibrationResult) -> str:
    """The source of a fitted value, as stated next to it in the model's file."""
    held = _held_out_error(result)
    return (
        f"calibrate: {settings.optimiser().name} on {settings.fitness}, seed {settings.seed}, {len(recorded.bags)} "
        f"bag{'s' * (len(recorded.bags) > 1)}, {today()}, held-out error "
        + (f"{held[1]:.3g} (before {held[0]:.3g})" if held else "none")
        + (", interrupted" if result.interrupted else "")
    )


def provenance_of(settings: Settings, recorded: Recorded, result: CalibrationResult) -> dict[str, Any]:
    """How the model's file was made."""
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
        "recordings": [asdict(change) for change in result.plays],
        "warnings": list(result.warnings),
        "notes": list(notes),
    }


def _held_out_error(result: CalibrationResult) -> tuple[float, float] | None:
    """Mean of E_C over signals in one unit and held-out commands, before and after; None where none were held out."""
    if not result.held_out_after:
        return None
    units = [s.unit for s in result.held_out_after]
    before, after = (
        mean_error([s.error for s in scores], units) for scores in (result.held_out_before, result.held_out_after)
    )
    return before, after


def _score(score: Score) -> dict[str, Any]:
    return {**asdict(score), "alikeness": {f"{k:g}": share for k, share in score.alikeness.items()}}
