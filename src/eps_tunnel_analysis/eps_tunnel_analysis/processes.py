# SPDX-License-Identifier: Apache-2.0
"""Programs as child processes: one that answers with JSON, and several that run together."""

import ctypes
import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

BAD_INPUT, INTERRUPTED = 2, 130  # exit codes; the second after Ctrl-C
POLL_S = 0.05
TIMING = 0.01
"""s by which nodes that share a computer come early or late anyhow: a sample at 100 Hz"""
GRACE = 8.0  # s from SIGINT to SIGKILL
_PR_SET_PDEATHSIG = 1


@dataclass(frozen=True)
class CommandResult:
    """How a command ended.

    Attributes:
        code: exit code.
        content: the JSON that it printed; None where it failed. An interrupted one may have some.
        complaint: its stderr without progress lines; never empty.
    """

    code: int
    content: dict[str, Any] | None
    complaint: str


def spare_threads() -> int:
    """Number of threads that leaves a core to nodes running at the same time, so that threads need not wait in turn."""
    return max(1, (os.cpu_count() or 1) - 1)


def run_program(
    module: str, given: str, progress: Callable[[dict[str, Any]], None], stopped: Callable[[], bool]
) -> CommandResult:
    """Runs `python -m MODULE`, which prints JSON, and its progress by lines.

    Args:
        given: what it reads from stdin.
        progress: called from another thread with every line of stderr that is a JSON object; a KeyError or TypeError in
            it makes the line a complaint.
        stopped: polled; when true the program is interrupted as by Ctrl-C.
    """
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
    process = subprocess.Popen(
        [sys.executable, "-m", module], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        text=True, env=environment, start_new_session=True,
    )  # fmt: skip
    assert process.stdin is not None
    with suppress(BrokenPipeError), process.stdin:  # it may have ended already
        process.stdin.write(given)
    complaints: list[str] = []
    output: list[str] = []
    assert process.stderr is not None
    assert process.stdout is not None
    readers = [
        threading.Thread(target=_follow, args=(process.stderr, progress, complaints), daemon=True),
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
    answered = process.returncode in (0, INTERRUPTED) and output[0]
    return CommandResult(
        process.returncode,
        json.loads(output[0]) if answered else None,
        "\n".join(complaints) or f"It ended with exit code {process.returncode}.",
    )


def _follow(stream: Any, progress: Callable[[dict[str, Any]], None], complaints: list[str]) -> None:
    for line in stream:
        try:
            entry = json.loads(line)
            if not isinstance(entry, dict):
                raise TypeError
            progress(entry)
        except (ValueError, KeyError, TypeError):
            complaints.append(line.strip())


class ProcessDied(Exception):
    """A program ended although it should run; the text shows its last lines, `code` is its exit code if it has one."""

    def __init__(self, text: str, code: int | None = None) -> None:
        super().__init__(text)
        self.code = code


class Processes:
    """Children with a log file each. They end in reverse order, and with this process should it be killed."""

    def __init__(self, logs: Path, environment: Mapping[str, str]) -> None:
        self._logs, self._environment = logs, dict(environment)
        self._running: dict[str, subprocess.Popen[bytes]] = {}

    def start(self, name: str, command: Sequence[str | Path]) -> None:
        """Starts a program whose output goes to logs/NAME.log."""
        with (self._logs / f"{name}.log").open("xb") as log:
            # A session of their own keeps Ctrl-C from them, so that they can be ended in order.
            self._running[name] = subprocess.Popen(
                [str(part) for part in command], stdin=subprocess.DEVNULL, stdout=log, stderr=subprocess.STDOUT,
                env=self._environment, start_new_session=True, preexec_fn=_die_with_parent,
            )  # fmt: skip

    def check(self) -> None:
        """Raises ProcessDied when a program is gone."""
        for name, process in self._running.items():
            if process.poll() is not None:
                text = f"{name} ended with {_ending(process.returncode)}. Its last lines:\n{self.tail(name)}"
                raise ProcessDied(text, process.returncode)

    def tail(self, name: str, lines: int = 15) -> str:
        """The last lines that a program printed."""
        text = (self._logs / f"{name}.log").read_text(encoding="utf-8", errors="replace")
        return "\n".join(f"  {line}" for line in text.splitlines()[-lines:]) or "  (it printed nothing)"

    def stop(self) -> list[str]:
        """Ends all, in reverse order of their start; returns the names of those that had to be killed."""
        killed = []
        for name, process in reversed(self._running.items()):
            if process.poll() is None:
                process.send_signal(signal.SIGINT)
            deadline = time.monotonic() + GRACE
            while process.poll() is None and time.monotonic() < deadline:
                time.sleep(0.02)
            if process.poll() is None:
                process.kill()
                process.wait()
                killed.append(name)
        self._running.clear()
        return killed

    def __enter__(self) -> "Processes":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()


def _ending(code: int) -> str:
    return f"exit code {code}" if code >= 0 else f"signal {signal.Signals(-code).name}"


def _die_with_parent() -> None:
    ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
    if os.getppid() == 1:
        os._exit(1)
