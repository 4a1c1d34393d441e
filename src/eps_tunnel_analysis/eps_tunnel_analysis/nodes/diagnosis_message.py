# SPDX-License-Identifier: Apache-2.0
"""A verdict as a message."""

import math
from collections.abc import Mapping
from typing import Any

from rclpy.qos import DurabilityPolicy, QoSProfile

from labyrinth_msgs.msg import Diagnosis

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def diagnosis_message(content: Mapping[str, Any], report: str) -> Diagnosis:
    """What diagnosis.json holds as a message without stamp. Errors are those of the model as given, and with what is
    named; NaN for the latter where nothing is."""

    def number(key: str, named: bool = True) -> float:
        value = content[key] if named else None
        return math.nan if value is None else float(value)

    named = content["verdict"] == "effect"
    return Diagnosis(
        verdict=content["verdict"],
        effects=list(content["effects"]),
        candidates=list(content["set"]),
        probabilities=[float(p) for p in content["set"].values()],
        coverage=float(content["coverage"]),
        sentence=content["sentence"],
        error_before=number("error_as_given"),
        error_after=number("error_after", named),
        held_out_before=number("held_out_as_given"),
        held_out_after=number("held_out_after", named),
        alikeness_before=number("alikeness_as_given"),
        alikeness_after=number("alikeness_after", named),
        next_experiment=content["next_experiment"] or "",
        report=report,
    )
