# SPDX-License-Identifier: Apache-2.0
"""The check of recordings against a model: its findings, and their wording."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from eps_tunnel_analysis.check.data import Finding, check_data, sentences
from eps_tunnel_analysis.check.excitation import Answer, Excited, excitation
from eps_tunnel_analysis.outputs import shown_number
from eps_tunnel_analysis.recorded_play import Play
from labyrinth_sim.model import Model
from labyrinth_sim.shown import shown

ANSWERS: tuple[Answer, ...] = ("identifiable", "weak", "no")
MENDED = 6  # effects for which the text says what to play; the JSON has all


@shown
@dataclass(frozen=True)
class Check:
    """Quality of recordings (`data`) and what they can identify (`excited`); `notes` from reading them."""

    data: tuple[Finding, ...]
    excited: tuple[Excited, ...]
    notes: tuple[str, ...]

    def to_json(self) -> dict[str, Any]:
        """Plain dicts, lists, numbers and words."""
        return {
            "data": [asdict(finding) for finding in self.data],
            "excited": [asdict(one) for one in self.excited],
            "notes": list(self.notes),
        }

    def __str__(self) -> str:
        return "\n".join(self.lines())

    def lines(self) -> list[str]:
        """In words, the serious first."""
        lines = sentences(self.data)
        lines += [note for note in self.notes if note not in lines]
        for axis in dict.fromkeys(one.axis for one in self.excited):
            lines += self._summary(axis, "value", "Values")
            lines += self._summary(axis, "effect", "Effects")
        return lines + self._mends()

    def _summary(self, axis: str, kind: str, noun: str) -> list[str]:
        own = [one for one in self.excited if one.axis == axis and one.kind == kind]
        said = []
        for answer in ANSWERS:
            names = [_name(one) for one in own if one.answer == answer]
            said += [f"{answer}: {', '.join(names)}"] if names else []
        return [f"{noun} of axis {axis} that these commands excite. {'; '.join(said)}."] if said else []

    def _mends(self) -> list[str]:
        """What to play: for all values of an axis at once, for the effects that show but are confused with others."""
        by_mend: dict[str, list[str]] = {}
        for one in self.excited:
            if one.kind == "value" and one.mend:
                by_mend.setdefault(f"axis {one.axis}: {one.mend}", []).append(one.name)
        lines = [f"To identify {', '.join(names)}, {mend.partition(': ')[2]}." for mend, names in by_mend.items()]
        alike = {
            tuple(sorted((one.name, *one.confounded))) for one in self.excited if one.kind == "value" and one.confounded
        }
        lines += [
            f"These can compensate for one another, so fix one of them: {', '.join(names)}." for names in sorted(alike)
        ]
        weak = [one for one in self.excited if one.kind == "effect" and one.answer == "weak" and one.confounded]
        lines += [f"To identify {one.name}: {one.mend}" for one in sorted(weak, key=lambda one: -one.figure)[:MENDED]]
        return lines


def _name(one: Excited) -> str:
    like = f" (not distinguishable from {', '.join(one.confounded)})" if one.confounded else ""
    if one.kind == "value" and one.answer != "no":
        return f"{one.name} ± {shown_number(one.figure, 2)} {one.unit}".removesuffix(" 1") + like
    return one.name + like


def check(
    model: Model,
    plays: Sequence[Play],
    notes: Sequence[str] = (),
    only: Sequence[str] | None = None,
    nthread: int = 0,
    progress: Callable[[str, int], None] | None = None,
) -> Check:
    """Checks recorded plays before anything is fitted.

    Args:
        notes: from reading them.
        only: effects to try; all by default.
    """
    return Check(check_data(model, plays), excitation(model, plays, only, nthread, progress), tuple(notes))
