# SPDX-License-Identifier: Apache-2.0
"""Units as people read them: degrees and millimetres outside, SI inside."""

import math

_SHOWN = {
    "rad": (180 / math.pi, "deg"),
    "rad/s": (180 / math.pi, "deg/s"),
    "m": (1000.0, "mm"),
    "m/s": (1000.0, "mm/s"),
    "1": (1.0, ""),
}


def shown_unit(unit: str) -> tuple[float, str]:
    """Factor from an SI unit to the one people read, and that unit's name ("" where there is none)."""
    return _SHOWN.get(unit, (1.0, unit))


def shown_value(value: float, unit: str, digits: int = 3) -> str:
    """A value in SI as people read it: shown_value(0.01, "rad") is "0.573 deg". NaN is a dash."""
    factor, name = shown_unit(unit)
    if math.isnan(value):
        return "–"
    return f"{value * factor:.{digits}g} {name}".rstrip()


def shown_share(share: float) -> str:
    """A share as a percentage with two digits after the point, as in the paper's tables. NaN is a dash."""
    return "–" if math.isnan(share) else f"{share * 100:.2f} %"
