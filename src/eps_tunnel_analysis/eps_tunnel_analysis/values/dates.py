# SPDX-License-Identifier: Apache-2.0
"""A rig over many dates: how alike the model of the first one is, and what became of some of its values."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from eps_tunnel_analysis.alikeness import KS, joint_against_itself
from eps_tunnel_analysis.compare import compare
from eps_tunnel_analysis.diagnose.axis_search import SearchOptions
from eps_tunnel_analysis.outputs import plain
from eps_tunnel_analysis.simulated import Diverged, Play, compared_signals, roll_out
from eps_tunnel_analysis.values.changes import ValueChange, refitted
from labyrinth_sim.model import Model


@dataclass(frozen=True)
class DateOfRig:
    """One date.

    Attributes:
        label: as the person named it.
        alikeness: k -> share of all seen samples alike in every signal, of the model of the first date.
        itself: k -> what the rig reached against itself on this date, jointly; NaN with too few trials.
        values: what the watched values are, given that nothing else changed; of the first date none.
    """

    label: str
    alikeness: Mapping[float, float]
    itself: Mapping[float, float]
    values: tuple[ValueChange, ...]

    def to_json(self) -> dict[str, Any]:
        """Plain dicts, lists, numbers and words; SI units."""
        found: dict[str, Any] = plain(
            {
                "label": self.label,
                "alikeness": [
                    {"k": k, "joint": share, "rig_against_itself": self.itself[k]}
                    for k, share in self.alikeness.items()
                ],
                "values": [asdict(v) for v in self.values],
            }
        )
        return found


def over_dates(
    model: Model,
    dates: Mapping[str, Sequence[Play]],
    watched: Sequence[str],
    ks: Sequence[float] = KS,
    run: SearchOptions | None = None,
) -> tuple[DateOfRig, ...]:
    """Alikeness and watched values on each date.

    Args:
        model: fitted to the first date.
        dates: label -> what was recorded, the first one first.
        watched: values and effects, as `Changes.named`.
    """
    first = next(iter(dates.values()))
    found = []
    for label, plays in dates.items():
        values = refitted(model, first, plays, watched, run) if watched and plays is not first else ()
        found.append(DateOfRig(label, _alikeness(model, plays, ks), _itself(model, plays, ks), values))
    return tuple(found)


def _itself(model: Model, plays: Sequence[Play], ks: Sequence[float]) -> dict[float, float]:
    names = compared_signals(model, [play.trials for play in plays])
    return joint_against_itself([play.trials.select(names) for play in plays], sorted(ks))


def _alikeness(model: Model, plays: Sequence[Play], ks: Sequence[float]) -> dict[float, float]:
    names = compared_signals(model, [play.trials for play in plays])
    alike, seen = dict.fromkeys(sorted(ks), 0.0), 0.0
    for play in plays:
        real = play.trials.select(names)
        try:
            comparison = compare(real, roll_out(model, play), ks, signals=names)
        except Diverged:
            continue
        seen += float(comparison.alikeness[0].seen.all(axis=1).sum())
        for a in comparison.alikeness:
            alike[a.k_real] += float(a.alike.all(axis=1).sum())
    return {k: count / max(seen, 1.0) for k, count in alike.items()}
