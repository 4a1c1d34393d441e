# SPDX-License-Identifier: Apache-2.0
"""Diagnosing and adding, one at a time, in a process of their own."""

import json
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from eps_tunnel_analysis.command_process import run_command, timing_options
from eps_tunnel_analysis.monitor.parts import Verdict
from labyrinth_sim.errors import InputError


@dataclass(frozen=True)
class Done:
    """How a piece of work ended: its content as the command prints it, or else why there is none.

    Attributes:
        kind: "diagnose" or "add".
        out: what the command wrote.
    """

    kind: str
    out: Path
    content: dict[str, Any] | None
    complaint: str


class Work:
    """The command that runs, if any.

    Attributes:
        kind: "diagnose", "add", or "" where nothing runs.
        told: how far it is, in words.
        began: monotonic s.
    """

    def __init__(self, ended: Callable[[Done], None]) -> None:
        self._ended = ended
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None
        self.kind, self.told, self.began = "", "", 0.0

    def diagnose(self, bags: Sequence[str], model: str, out: Path, candidates: Sequence[str]) -> None:
        """`ended` gets the content of diagnosis.json, from another thread; so for `add`."""
        only = ["--candidates", *candidates] if candidates else []
        given = ["diagnose", "--real", *bags, "--model", model, "--out", str(out), *timing_options(), *only]
        self._start("diagnose", given, out)

    def add(self, names: Sequence[str], bags: Sequence[str], model: str, out: Path) -> None:
        """Writes the model with the effects fitted to `out`."""
        self._start("add", ["add-effect", *names, "--real", *bags, "--model", model, "--out", str(out)], out)

    def stop(self) -> None:
        """Interrupts what runs."""
        self._stop.set()

    def close(self) -> None:
        """Interrupts what runs and waits for its end."""
        self._stop.set()
        if self._thread is not None:
            self._thread.join()

    def _start(self, kind: str, arguments: list[str], out: Path) -> None:
        if self.kind:
            raise InputError(f"Wait until the present work ({self.kind}) has ended, or stop it.")
        self._stop.clear()
        self.kind, self.told, self.began = kind, "reading the bags", time.monotonic()
        self._thread = threading.Thread(target=self._run, args=(kind, arguments, out), name=kind)
        self._thread.start()

    def _run(self, kind: str, arguments: list[str], out: Path) -> None:
        def tell(told: dict[str, Any]) -> None:
            self.told = f"{told['doing']}, {told['rollouts']:,} simulations"

        content, complaint = None, ""
        try:
            output = run_command(arguments, tell, self._stop.is_set)
            if self._stop.is_set():
                complaint = "Stopped."
            elif output.code == 0:
                content = json.loads(output.text)
            else:
                complaint = "\n".join(output.complaints[-5:]) or f"It ended with exit code {output.code}."
        except Exception as error:  # a thread that died silently would leave the page waiting for ever
            complaint = f"It failed: {error!r}."
        self.kind = ""
        self._ended(Done(kind, out, content, complaint))


def verdict_of(content: dict[str, Any], report: str, experiment: str) -> Verdict:
    """The verdict in a diagnosis.json."""
    stated = content["stated_set"]
    return Verdict(
        verdict=content["verdict"],
        sentence=content["sentence"],
        effects=tuple(content["effects"]),
        hypotheses=tuple((name, p, name in stated) for name, p in content["set"].items()),
        where=tuple((s["signal"] or "", s["start"], s["end"]) for s in content["where"]),
        coverage=content["coverage"],
        held_out=(content["held_out_as_given"], content["held_out_before"], content["held_out_after"]),
        model=content["model"],
        next_experiment=experiment,
        report=report,
        notes=tuple(content["notes"]),
    )
