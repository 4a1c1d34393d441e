# SPDX-License-Identifier: Apache-2.0
"""Fit: what was tried, what was found, how sure that is, and what to be wary of."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

from eps_tunnel_analysis.fit.evaluations import Step


@dataclass(frozen=True)
class Fitted:
    """One free parameter after a fit.

    Attributes:
        name, unit: the full parameter name and its unit.
        start, value: before and after, in that unit.
        half_width: of the 95 % interval, in that unit; NaN where no interval could be computed.
        low, high: the bounds.
        at_bound: the value lies at one of them, so the true one may lie beyond.
    """

    name: str
    unit: str
    start: float
    value: float
    half_width: float
    low: float
    high: float
    at_bound: bool


@dataclass(frozen=True)
class Fit:
    """The result of a calibration.

    Attributes:
        method, fitness, seed: how it was made.
        parameters: one for each free parameter.
        before, after: fitness on the commands that were fitted.
        held_out_before, held_out_after: on those that were not; NaN where none were held out.
        fitted_plays, held_out_plays: their names.
        converged: no step that the residuals' slope promises would gain 5 % or more.
        interrupted: ended by Ctrl-C; the values are the best until then.
        evaluations: parameter sets simulated, each on all commands.
        seconds: wall time.
        history: where the best improved.
        warnings: one sentence each.
        about: data, versions and whatever else the caller knows.
    """

    method: str
    fitness: str
    seed: int
    parameters: tuple[Fitted, ...]
    before: float
    after: float
    held_out_before: float
    held_out_after: float
    fitted_plays: tuple[str, ...]
    held_out_plays: tuple[str, ...]
    converged: bool
    interrupted: bool
    evaluations: int
    seconds: float
    history: tuple[Step, ...]
    warnings: tuple[str, ...]
    about: Mapping[str, Any] = field(default_factory=dict)

    @property
    def values(self) -> dict[str, float]:
        """Full parameter name -> fitted value."""
        return {p.name: p.value for p in self.parameters}

    def to_json(self) -> dict[str, Any]:
        """Plain dicts, lists, numbers and words; NaN becomes None."""
        return {key: _plain(value) for key, value in asdict(self).items()}


def _plain(content: Any) -> Any:
    if isinstance(content, dict):
        return {key: _plain(value) for key, value in content.items()}
    if isinstance(content, list | tuple):
        return [_plain(value) for value in content]
    return None if isinstance(content, float) and content != content else content
