# SPDX-License-Identifier: Apache-2.0
"""Programs of the workspace as child processes: started, watched and ended together."""

import ctypes
import os
import signal
import subprocess
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType

from ament_index_python.packages import PackageNotFoundError, get_package_prefix

from labyrinth_sim.errors import InputError

GRACE = 8.0  # s from SIGINT to SIGKILL
_PR_SET_PDEATHSIG = 1


class ProcessDied(Exception):
    """A program ended although it should run; the text shows its last lines, `code` is its exit code if it has one."""

    def __init__(self, text: str, code: int | None = None) -> None:
        super().__init__(text)
        self.code = code


def executable(package: str, name: str) -> Path:
    """The file that `ros2 run PACKAGE NAME` starts. Raises InputError where the workspace is not sourced."""
    try:
        path = Path(get_package_prefix(package)) / "lib" / package / name
    except PackageNotFoundError:
        raise InputError(f"Package {package} is not found. Source the workspace: `source env.bash`.") from None
    if not path.is_file():
        raise InputError(f"{path} is missing. Build the workspace: `make setup`.")
    return path


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
                told = f"{name} ended with {_told(process.returncode)}. Its last lines:\n{self.tail(name)}"
                raise ProcessDied(told, process.returncode)

    def tail(self, name: str, lines: int = 15) -> str:
        """The last lines that a program printed."""
        text = (self._logs / f"{name}.log").read_text(encoding="utf-8", errors="replace")
        return "\n".join(f"  {line}" for line in text.splitlines()[-lines:]) or "  (it printed nothing)"

    def stop(self) -> list[str]:
        """Ends all, the last one started first; returns the names of those that had to be killed."""
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


def _told(code: int) -> str:
    return f"exit code {code}" if code >= 0 else f"signal {signal.Signals(-code).name}"


def _die_with_parent() -> None:
    ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
    if os.getppid() == 1:
        os._exit(1)
