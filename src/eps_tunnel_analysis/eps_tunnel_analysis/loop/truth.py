# SPDX-License-Identifier: Apache-2.0
"""Whether a verdict is right, where what was hidden is known."""

from collections.abc import Mapping, Sequence
from typing import Any

from eps_tunnel_analysis.diagnose.rank import NONE, UNKNOWN
from eps_tunnel_analysis.diagnose.verdict import in_words
from labyrinth_sim.registry import Registry


def truth(hidden: Sequence[Mapping[str, Any]]) -> str:
    """The hypothesis that is true, as a verdict's set names it; `hidden` as the testbed's --reveal writes it."""
    if not hidden:
        return NONE
    if not all(item["known"] for item in hidden):
        return UNKNOWN
    places = {item["effect"]: ("x", "y") if item["axis"] == "both" else (item["axis"],) for item in hidden}
    return " + ".join(sorted(f"{effect}.{place}" for effect, found in places.items() for place in found))


def judged(
    hidden: Sequence[Mapping[str, Any]], effects: Sequence[str], ending: str, stated: Sequence[str], registry: Registry
) -> str:
    """Whether it was found.

    Args:
        effects: every effect that was named.
        ending: the last verdict: complete, effect, undecided or unknown.
        stated: the hypotheses that the last verdict leaves.
        registry: has the effects' titles.
    """
    true = truth(hidden)
    said = " + ".join(sorted(effects)) or {"unknown": UNKNOWN, "complete": NONE}.get(ending, "")
    if said == true and ending != "undecided":
        return "Right." if effects else f"Right: the verdict was '{ending}'."
    hid = set(true.split(" + "))
    if hid <= set(effects):
        more = " and ".join(in_words(name, registry) for name in sorted(set(effects) - hid))
        return f"It was found; named besides: {more}." if more else "It was found; whether that is all is not decided."
    if ending == "undecided" and true in stated:
        return f"It is one of the {len(stated)} hypotheses that these recordings leave."
    naming = [set(name.split(" + ")) for name in stated if name not in (NONE, UNKNOWN)]
    if ending == "undecided" and naming and all(hid <= names for names in naming):
        return "It was found; whether that is all is not decided."
    return "That was not found."
