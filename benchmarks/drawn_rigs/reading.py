# SPDX-License-Identifier: Apache-2.0
"""All that this benchmark takes from the programs that it judges: the bag's way in and out, the diagnosis, and how a
true form is declared.
"""

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

from eps_tunnel_analysis.diagnose.addition import add_effects
from eps_tunnel_analysis.diagnose.axes import Diagnosis
from eps_tunnel_analysis.diagnose.diagnose import diagnose
from eps_tunnel_analysis.law.depends import Dependence
from eps_tunnel_analysis.law.proposal import Proposal, proposal_of
from eps_tunnel_analysis.law.refit import floors_on, with_effect_fitted, with_own_effect_fitted
from eps_tunnel_analysis.recorded_play import Play
from eps_tunnel_analysis.recording.decode import read_all
from eps_tunnel_analysis.recording.decode import typestore as _typestore
from eps_tunnel_analysis.recording.trials import to_plays
from eps_tunnel_analysis.recording.writer import BagWriter
from labyrinth_sim import filters
from labyrinth_sim.curve import other_angle
from labyrinth_sim.effect import Effect, Parameter, Values, effects
from labyrinth_sim.law import law, state
from labyrinth_sim.model import Model, load_model
from labyrinth_sim.site import Site
from labyrinth_sim.trials import Array

__all__ = ["Array", "BagWriter", "Dependence", "Diagnosis", "Effect", "Model", "Parameter", "Play", "Proposal", "Site",
           "Values", "add_effects", "diagnose", "filters", "floors_on", "law", "law_of", "library_names", "loaded",
           "other_angle", "state", "typestore", "with_effect_fitted", "with_own_effect_fitted"]  # fmt: skip


@lru_cache(maxsize=1)
def typestore() -> Any:
    """Message types of ROS 2 and of labyrinth_msgs."""
    return _typestore()


def loaded(model: Path, bags: Sequence[Path]) -> tuple[Model, list[Play]]:
    """A model and the plays of bags, as the command line reads them, at the rig's own rate."""
    known = load_model(model)
    return known, list(to_plays(read_all(bags), known.rig, rate=1.0 / known.rig.sample_time).plays)


def law_of(model: Model, plays: Sequence[Play], threads: int, seed: int) -> tuple[str, Model, Proposal | None]:
    """The verdict of a diagnosis that has no effects to choose from, the refitted model, and what is proposed."""
    diagnosis = diagnose(model, plays, seed=seed, only=(), nthread=threads, experiments=False)
    return diagnosis.verdict.verdict, diagnosis.base_model, proposal_of(diagnosis, plays, threads, seed)


def library_names() -> tuple[str, ...]:
    """Names of the library's effects on axes and sensors; those on the ball concern no drawn rig, and free curves are
    no names.
    """
    known = {name: effect for name, effect in effects().items() if not effect.nameless}
    return tuple(name for name, effect in known.items() if effect.where != "ball" and "ball" not in effect.needs)
