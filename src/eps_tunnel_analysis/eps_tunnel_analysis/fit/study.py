# SPDX-License-Identifier: Apache-2.0
"""A whole calibration: which commands are held out, one fit or one for each axis, and the model that comes of it."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from eps_tunnel_analysis.fit.calibrate import Settings, calibrate
from eps_tunnel_analysis.fit.evaluations import Progress
from eps_tunnel_analysis.fit.free import Part, by_axis
from eps_tunnel_analysis.fit.judge import Score, judge
from eps_tunnel_analysis.fit.result import Fit
from eps_tunnel_analysis.plays import Play
from labyrinth_sim.errors import InputError
from labyrinth_sim.model import Model

#: Told before each fit of its part and its likely number of evaluations; gives what is called as the fit goes on.
Bars = Callable[[Part, int], Progress]


@dataclass(frozen=True)
class Calibration:
    """Attributes:
    model: with the fitted values, their source not told yet; see `signed`.
    parts, fits: what was fitted, and how it went; one unless fitted axis by axis, fewer after an interruption.
    before, after: scores on the fitted plays, signal by signal.
    held_out_before, held_out_after: on those held out; empty where none were.
    """

    model: Model
    parts: tuple[Part, ...]
    fits: tuple[Fit, ...]
    before: tuple[Score, ...]
    after: tuple[Score, ...]
    held_out_before: tuple[Score, ...]
    held_out_after: tuple[Score, ...]

    @property
    def values(self) -> dict[str, float]:
        """Full parameter name -> fitted value."""
        return {name: value for fit in self.fits for name, value in fit.values.items()}

    @property
    def interrupted(self) -> bool:
        return any(fit.interrupted for fit in self.fits)

    @property
    def warnings(self) -> tuple[str, ...]:
        return tuple(text for fit in self.fits for text in fit.warnings)

    def signed(self, source: str, provenance: Mapping[str, Any]) -> Model:
        """The model with `source` at each fitted value, and `provenance`."""
        return replace(self.model.with_values(self.values, source), provenance=dict(provenance))


def calibrate_model(
    model: Model,
    plays: Sequence[Play],
    free: Sequence[str],
    settings: Settings,
    axis_by_axis: bool = False,
    bars: Bars | None = None,
) -> Calibration:
    """Fits a model to plays.

    Args:
        free: full parameter names.
        settings: `held_out` counts the plays as given here; a checkpoint of a fit axis by axis is one file for each
            axis, named after it.
        axis_by_axis: one fit after the other, each to its axis's signals, as in the paper; else one for all.

    Raises:
        InputError: see `calibrate`.
    """
    everything = Part("", tuple(free), settings.signals, tuple(range(len(plays))))
    parts = by_axis(model, free, plays, settings.signals) if axis_by_axis else [everything]
    fits: list[Fit] = []
    fitted = model
    for part in parts:
        held = tuple(at for at, number in enumerate(part.plays) if number in settings.held_out)
        if len(held) == len(part.plays):
            names = ", ".join(plays[i].name for i in part.plays)
            raise InputError(
                f"Every command that moves axis {part.axis} is held out ({names}). Hold out fewer, or draw others by "
                "another seed."
            )
        journal = settings.journal
        if journal is not None and part.axis:
            journal = journal.with_name(f"{journal.name}.{part.axis}")
        mine = replace(settings, signals=part.signals, held_out=held, journal=journal)
        bar = bars(part, settings.budget or settings.optimiser().budget) if bars else None
        fit = calibrate(fitted, part.free, [plays[i] for i in part.plays], mine, bar)
        fits.append(fit)
        fitted = fitted.with_values(fit.values, "fitted")
        if fit.interrupted:
            break
    seen = [play for number, play in enumerate(plays) if number not in settings.held_out]
    unseen = [play for number, play in enumerate(plays) if number in settings.held_out]
    scores = [
        judge(which, some, settings.signals, timestep=settings.timestep) if some else ()
        for some in (seen, unseen)
        for which in (model, fitted)
    ]
    return Calibration(fitted, tuple(parts[: len(fits)]), tuple(fits), *scores)
