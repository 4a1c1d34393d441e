# SPDX-License-Identifier: Apache-2.0
"""A command of eps-tunnel in a process of its own, so that whoever asks for it stays awake and can call it off."""

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
TIMING = 0.01
"""s by which nodes that share a computer come early or late anyhow: a sample at 100 Hz"""


@dataclass(frozen=True)
class Output:
    """How a command ended: exit code, what it printed to stdout, and the lines of stderr that told no progress."""

    code: int
    text: str
    complaints: tuple[str, ...]


def timing_options(timing: float = TIMING) -> list[str]:
    """Options of a diagnosis of what a rig with this uneven timing recorded, in s."""
    return ["--timing-ms", f"{1e3 * timing:g}"]


def spare_threads() -> int:
    """Threads that leave a core to nodes which run beside: where one of two waits for its turn, both wait."""
    return max(1, (os.cpu_count() or 1) - 1)


def run_command(
    arguments: Sequence[str], tell: Callable[[dict[str, Any]], None], stopped: Callable[[], bool]
) -> Output:
    """Runs `eps-tunnel ARGUMENTS`, leaving a core to the nodes beside it; it prints JSON, and its progress by lines.

    Args:
        arguments: those of the command line, without threads and output.
        tell: called from another thread with every line of stderr that is a JSON object, as `--progress lines` prints
            them; a KeyError or TypeError in it makes the line a complaint.
        stopped: asked now and then; once true the command is interrupted as by Ctrl-C.
    """
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
    every = [*arguments, "--threads", str(spare_threads()), "--json", "--progress", "lines"]
    process = subprocess.Popen(
        [sys.executable, "-m", "eps_tunnel_analysis.cli", *every], stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
        stderr=subprocess.PIPE, text=True, env=environment, start_new_session=True,
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
    return Output(process.returncode, output[0], tuple(complaints))


def _follow(stream: Any, tell: Callable[[dict[str, Any]], None], complaints: list[str]) -> None:
    for line in stream:
        try:
            told = json.loads(line)
            if not isinstance(told, dict):
                raise TypeError
            tell(told)
        except (ValueError, KeyError, TypeError):
            complaints.append(line.strip())
