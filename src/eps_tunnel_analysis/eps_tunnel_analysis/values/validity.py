# SPDX-License-Identifier: Apache-2.0
"""The validity region of a model that was judged by recordings, for its file."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from eps_tunnel_analysis.fit.calibrate import judge
from eps_tunnel_analysis.simulated import Diverged, Play, roll_out
from eps_tunnel_analysis.valid import ranges
from labyrinth_sim.model import Model
from labyrinth_sim.validity import Validity


def validity_of(
    model: Model, plays: Sequence[Play], held: Sequence[Play], bags: Sequence[tuple[Path, str]]
) -> Validity | None:
    """Where a model was shown to hold.

    Args:
        plays, held: what was fitted, and what was not; the errors are those of the latter where there are any.
        bags: path and SHA-256 of each recording.

    Returns:
        None where the simulation diverges on one of them.
    """
    every = [*plays, *held]
    try:
        found = ranges([play.trials for play in every], [roll_out(model, play) for play in every])
    except Diverged:
        return None
    for score in judge(model, held or plays):
        if score.signal in found:
            found[score.signal] = replace(found[score.signal], error=score.error)
    return Validity(found, tuple(p.name for p in held), tuple(f"{path} {digest[:12]}" for path, digest in bags))
