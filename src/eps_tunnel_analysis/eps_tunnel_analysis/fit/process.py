# SPDX-License-Identifier: Apache-2.0
"""A calibration in a process of its own, so that whoever asks for it stays awake and can call it off."""

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

POLL_S = 0.05
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
        arguments: those of the command line, without --json and --progress.
        tell: called as the fit goes on, from another thread.
        stopped: asked now and then; once true the fit is interrupted and keeps the best so far.
    """
    command = [
        sys.executable,
        "-m",
        "eps_tunnel_analysis.cli",
        "calibrate",
        *arguments,
        "--json",
        "--progress",
        "lines",
    ]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
    process = subprocess.Popen(
        command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment,
        start_new_session=True,
    )  # fmt: skip
    complaints: list[str] = []
    output: list[str] = []
    assert process.stderr is not None
    assert process.stdout is not None
    readers = [
        threading.Thread(target=_follow, args=(process.stderr, tell, complaints), daemon=True),
        threading.Thread(target=lambda: output.append(process.stdout.read() if process.stdout else ""), daemon=True),
    ]
    for reader in readers:
        reader.start()
    asked = False
    try:
        while process.poll() is None:
            if not asked and stopped():
                asked = True
                process.send_signal(signal.SIGINT)
            time.sleep(POLL_S)
    finally:
        if process.poll() is None:
            process.kill()
        process.wait()
    for reader in readers:
        reader.join()
    if process.returncode not in (0, INTERRUPTED) or not output[0]:
        return Ended(False, "\n".join(complaints) or f"It ended with exit code {process.returncode}.", {})
    content = json.loads(output[0])
    words = [f"{name} = {value:.6g}" for name, value in content["values"].items()]
    ending = "Interrupted; the best so far: " if content["interrupted"] else ""
    return Ended(not content["interrupted"], ending + ", ".join(words) + ".", content)


def _follow(stream: Any, tell: Callable[[Told], None], complaints: list[str]) -> None:
    for line in stream:
        try:
            told = json.loads(line)
            tell(Told(told["evaluations"] / told["of"], told["best"], told["evaluations"]))
        except (ValueError, KeyError, TypeError):
            complaints.append(line.strip())
