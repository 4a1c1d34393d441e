# SPDX-License-Identifier: Apache-2.0
"""A calibration in a process of its own, so that whoever asks for it stays awake and can call it off."""

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from eps_tunnel_analysis.command_process import run_command

INTERRUPTED = 130


@dataclass(frozen=True)
class Told:
    """How far a calibration is: share of the work 0..1, best fitness so far, evaluations so far."""

    share: float
    best: float
    evaluations: int


@dataclass(frozen=True)
class Ended:
    """How a calibration ended.

    Attributes:
        success: it ran to its end.
        message: what was found, or every complaint.
        content: as `eps-tunnel calibrate --json` prints it; empty where it found nothing.
    """

    success: bool
    message: str
    content: dict[str, Any]


def run_calibration(arguments: Sequence[str], tell: Callable[[Told], None], stopped: Callable[[], bool]) -> Ended:
    """Runs `eps-tunnel calibrate ARGUMENTS`.

    Args:
        arguments: those of the command line, without threads and output.
        tell: called as the fit goes on, from another thread.
        stopped: asked now and then; once true the fit is interrupted and keeps the best so far.
    """
    output = run_command(
        ["calibrate", *arguments],
        lambda told: tell(Told(told["evaluations"] / told["of"], told["best"], told["evaluations"])),
        stopped,
    )
    if output.code not in (0, INTERRUPTED) or not output.text:
        return Ended(False, "\n".join(output.complaints) or f"It ended with exit code {output.code}.", {})
    content = json.loads(output.text)
    words = [f"{name} = {value:.6g}" for name, value in content["values"].items()]
    ending = "Interrupted; the best so far: " if content["interrupted"] else ""
    return Ended(not content["interrupted"], ending + ", ".join(words) + ".", content)
