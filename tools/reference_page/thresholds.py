# SPDX-License-Identifier: Apache-2.0
"""The numbers on which a verdict depends, from their docstring."""

import inspect
import re
from dataclasses import fields

from eps_tunnel_analysis.diagnose.settings import DiagnosisSettings
from reference_page.tables import code, table

ENTRY = re.compile(r"^(\w+): (.*)$")
INTRODUCTION = """## Numbers of the diagnosis

Every number on which a verdict depends. "Floors" are mean squares in units of the noise floor: 1 is what a perfect
model leaves. They are in `eps_tunnel_analysis/diagnose/settings.py`.

"""


def meanings() -> dict[str, str]:
    """Name -> what its docstring says of it."""
    said: dict[str, str] = {}
    name = ""
    for line in (inspect.getdoc(DiagnosisSettings) or "").splitlines():
        if entry := ENTRY.match(line):
            name, said[entry[1]] = entry[1], entry[2]
        elif name:
            said[name] += f" {line.strip()}"
    return said


def section() -> str:
    """The table of the reference page."""
    said = meanings()
    rows = [(code(f.name), f"{f.default:.3g}" if isinstance(f.default, float) else str(f.default), said[f.name])
            for f in fields(DiagnosisSettings)]  # fmt: skip
    return INTRODUCTION + table(("name", "value", "unit, meaning, source"), rows)
