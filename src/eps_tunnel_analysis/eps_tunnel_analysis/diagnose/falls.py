# SPDX-License-Identifier: Apache-2.0
"""By how much an error fell: against which yardstick, and recording by recording.

The yardsticks are the model as given and the same with its values refitted; a mean over recordings can fall while some
of them get worse.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from eps_tunnel_analysis.diagnose.verdict import Errors, PlayError
from eps_tunnel_analysis.outputs import shown_share, shown_value

WORSE_LISTED = 3  # recordings that got worse

Three = tuple[Errors, Errors, Errors]
"""Of the model as given, with its values refitted, and with the effects."""


@dataclass(frozen=True)
class RecordingErrors:
    """One recording: its name, whether it was held out of the fit, and the errors of three models on it in `unit`."""

    name: str
    held_out: bool
    given: float
    refitted: float
    after: float
    unit: str = "rad"

    @property
    def change(self) -> float:
        """Error with the effects over that of the model as given."""
        return self.after / self.given if self.given else 1.0

    @property
    def row(self) -> tuple[str, str, str, str, str, str]:
        """For display: name, fitted or held out, three errors, change against the model as given."""
        errors = (shown_value(e, self.unit) for e in (self.given, self.refitted, self.after))
        given, refitted, after = errors
        return self.name, "held out" if self.held_out else "fitted", given, refitted, after, f"{self.change - 1:+.0%}"


RECORDING_COLUMNS = ("recording", "", "as given", "refitted", "with effects", "against as given")


def by_recording(plays: Sequence[Sequence[PlayError]], unit: str = "rad") -> list[RecordingErrors]:
    """One entry per recording, worst change first.

    Args:
        plays: for each of the three models, the error of each recording.
        unit: of the errors, the rig's `position_unit`.
    """
    three = zip(*plays, strict=True)
    joined = [RecordingErrors(g.name, g.held_out, g.error, r.error, a.error, unit) for g, r, a in three]
    return sorted(joined, key=lambda one: -one.change)


def fall_sentences(
    errors: Three,
    plays: Sequence[Sequence[PlayError]],
    unit: str = "rad",
    itself: float = math.nan,
    ball: bool | None = None,
) -> list[str]:
    """How the effects changed the error: recordings that got worse first, then what was fitted, then what was not.

    Empty if nothing was measured in this unit.

    Args:
        unit: of the errors, and of those of the recordings.
        itself: alikeness that the rig reaches against itself at k = 1; NaN where unknown.
        ball: whether the errors are those of the ball, which recordings and alikeness do not cover; None: they are if
            the unit is m.
    """
    ball = unit == "m" if ball is None else ball
    recordings = [] if ball else by_recording(plays, unit)
    worse = [one for one in recordings if one.change > 1.0]
    sentences = []
    if worse:
        shown = "; ".join(
            f"{one.name} ({one.row[1]}), {one.row[2]} as given, {one.row[4]} now" for one in worse[:WORSE_LISTED]
        )
        more = f"; {len(worse) - WORSE_LISTED} more" if len(worse) > WORSE_LISTED else ""
        sentences.append(
            f"Worse than the model as given on {len(worse)} of {len(recordings)} recordings: {shown}{more}."
        )
    given, refitted, after = errors
    if not math.isfinite(given.error):
        return []  # no signal in this unit
    held = any(one.held_out for one in recordings)
    kept = "On recordings held out" if held else "On stretches of time left out of the fit"
    sentences.append(_fall("On what was fitted", (given.error, refitted.error, after.error), unit))
    sentences.append(_fall(kept, (given.held_out, refitted.held_out, after.held_out), unit))
    if not ball:
        alike = [shown_share(e.alikeness) for e in errors]
        sentences.append(
            f"Alikeness at k = 1: {alike[0]} as given, {alike[1]} with its values refitted, {alike[2]} now"
            f"{of_rig(itself)}."
        )
    if after.held_out >= refitted.held_out:
        sentences.append("On what was not fitted it is no better than refitted values alone: leave it out.")
    return sentences


def of_rig(itself: float) -> str:
    """What the rig reaches against itself, as the end of a sentence on alikeness; empty if unknown."""
    return "" if math.isnan(itself) else f"; the rig against itself reaches {shown_share(itself)}"


def _fall(where: str, errors: tuple[float, float, float], unit: str) -> str:
    given, refitted, after = (shown_value(e, unit) for e in errors)
    return (
        f"{where}, the mean error is {after}: {_change(errors[2], errors[0])} than that of the model as given "
        f"({given}), {_change(errors[2], errors[1])} than with its values refitted ({refitted})."
    )


def _change(after: float, before: float) -> str:
    change = after / before - 1.0 if before else 0.0
    share = "over 99%" if -1.0 < change < -0.99 else f"{abs(change):.0%}"
    return f"{share} {'higher' if change > 0 else 'lower'}"
