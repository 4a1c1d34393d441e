# SPDX-License-Identifier: Apache-2.0
"""The course of a session at the page: play, diagnose, add, play again. One job at a time; and values to vary."""

import queue
import threading
import time
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from eps_tunnel_analysis.inputs import load_recorded
from eps_tunnel_analysis.monitor.parts import (
    Adjustables,
    Before,
    Choices,
    Connections,
    GapPart,
    Job,
    RunPart,
    VerdictPart,
    WhatIfPart,
    rig_of,
)
from eps_tunnel_analysis.monitor.requests import (
    AddRequest,
    ArmRequest,
    DiagnoseRequest,
    PlayRequest,
    Request,
    StopRequest,
    WhatIfRequest,
)
from eps_tunnel_analysis.monitor.state import (
    BEFORE,
    BY_HAND,
    COLLECTING,
    NOT_SEEN,
    SIMULATED,
    TUNNEL_TRIALS,
    State,
    Steps,
    table_rows,
)
from eps_tunnel_analysis.outputs import numbered_folder, shown_number
from eps_tunnel_analysis.processes import CommandResult
from eps_tunnel_analysis.sequence_file import find_sequence
from eps_tunnel_analysis.tasks import AddTask, DiagnoseTask, run_task
from eps_tunnel_analysis.terminal import rollout_line
from eps_tunnel_analysis.values.sweep import Adjustable, WhatIf, WhatIfAnswer, adjustable
from labyrinth_sim import config
from labyrinth_sim.errors import InputError, unknown_name
from labyrinth_sim.model import load_model
from labyrinth_sim.registry import Registry

UNWATCHED = 20.0  # s without an open page after which the rig is no longer armed
EXPERIMENT = "next_experiment.yaml"


class Work:
    """A task in a separate process, if any.

    Attributes:
        doing: its progress, in words.
        began: monotonic s.
    """

    def __init__(self) -> None:
        self._threads = ThreadPoolExecutor(1, "work")
        self._stop = threading.Event()
        self._task: DiagnoseTask | AddTask | None = None
        self._result: Future[CommandResult] = Future()
        self.doing, self.began = "", 0.0

    @property
    def kind(self) -> str:
        """ "diagnose", "add", or "" where nothing runs."""
        return self._task.kind if self._task else ""

    def start(self, task: DiagnoseTask | AddTask) -> None:
        """Begins a task; `ended` reports its end."""
        self._stop.clear()
        self._task, self.doing, self.began = task, "reading the bags", time.monotonic()
        self._result = self._threads.submit(run_task, task, self._show, self._stop.is_set)

    def stop(self) -> None:
        """Interrupts what runs."""
        self._stop.set()

    def close(self) -> None:
        """Interrupts what runs and waits for its end."""
        self._stop.set()
        self._threads.shutdown()

    def ended(self) -> tuple[Path, dict[str, Any] | None, str, str] | None:
        """The task that ended since the last call: its file, its content or None, its kind, and a complaint."""
        if self._task is None or not self._result.done():
            return None
        task, self._task = self._task, None
        try:
            result = self._result.result()
        except Exception as error:  # a thread that died silently would leave the page waiting for ever
            return task.out, None, task.kind, f"It failed: {error!r}."
        if self._stop.is_set():
            return task.out, None, task.kind, "Stopped."
        return task.out, result.content, task.kind, "\n".join(result.complaint.splitlines()[-5:])

    def _show(self, progress: dict[str, Any]) -> None:
        self.doing = rollout_line(
            progress["doing"], progress["rollouts"], progress["of"], time.monotonic() - self.began
        )


def verdict_of(content: dict[str, Any], report: str, experiment: str) -> VerdictPart:
    """The verdict in a diagnosis.json."""
    stated = content["stated_set"]
    return VerdictPart(
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


class RigAccess(Protocol):
    """What moves the rig and feeds the simulation."""

    @property
    def ready(self) -> bool:
        """Whether a player is running."""

    @property
    def playing(self) -> bool:
        """Whether a run was requested and has not ended; `Session.played` is called at its end."""

    def alive(self, side: str) -> bool:
        """Whether a side publishes joint states."""

    @property
    def analysed(self) -> bool:
        """Whether both sides are compared and recorded."""

    def play(self, sequence: str, trials: int, folder: Path) -> None:
        """Plays on every side and records one bag per side in `folder`."""

    def stop(self) -> None:
        """Ends the run early."""

    def load(self, model: Path) -> None:
        """Loads a model into the simulation; `Session.loaded` is called with the answer."""

    def publish(self, verdict: dict[str, Any], report: str) -> None:
        """Publishes the content of a diagnosis.json and sends it to all pages."""


class Session:
    """Takes requests from any thread and carries them out in the one that calls `look`.

    Args:
        out: folder in which monitor-N is made as soon as something is to be kept.
        model: name or path of the model to diagnose where the simulation reports no file.
        candidates: effects to consider in a diagnosis; none for all.

    Attributes:
        reports: HTML reports by number.
    """

    def __init__(
        self, state: State, steps: Steps, rig: RigAccess, out: Path, model: str, candidates: Sequence[str]
    ) -> None:
        self._state, self._steps, self._rig = state, steps, rig
        self._out, self._given_model, self._candidates = out, model, tuple(candidates)
        self._registry = Registry.load()
        self._requests: queue.Queue[Request] = queue.Queue()
        self._work = Work()
        self._reruns = Reruns(state)
        self._folder: Path | None = None
        self._made = {"play": 0, "diagnosis": 0, "model": 0}
        self._bags: tuple[str, ...] = ()
        self._armed, self._watched = False, time.monotonic()
        self._loading = False
        self._began = 0.0
        self._sequence = self._adding = ""
        self._experiments: list[str] = []
        self._offered: tuple[str, ...] = ()
        self.reports: dict[int, Path] = {}
        self._offer()

    def ask(self, request: Request) -> None:
        """Takes a request; may be called from any thread.

        Raises:
            InputError: a value that cannot be varied now. Such requests do not wait for the next look: a slider is
                expected to follow at once.
        """
        match request:
            case WhatIfRequest("", _):
                self._reruns.end()
            case WhatIfRequest(name, value):
                if self._rig.playing:
                    raise InputError("Wait until the run has ended: a simulation at the same time would disturb it.")
                self._reruns.ask(name, value)
            case _:
                self._requests.put(request)

    def look(self, pages: int) -> None:
        """Carries out requests and follow-ups of finished jobs; `pages` are open. To be called often."""
        if ended := self._work.ended():
            self._worked(*ended)
        while not self._requests.empty():
            request = self._requests.get()
            try:
                self._do(request)
            except (InputError, OSError) as error:
                self._state.note(str(error), "error")
        self._disarm_unwatched(pages)
        self._show()

    def show_rig(self) -> None:
        """Shows the rig of the model that runs now."""
        try:
            self._state.put(rig_of(load_model(self._model or self._steps.model)))
        except InputError as error:
            self._state.note(f"The board cannot be drawn: {error}", "error")
        self._move_values()

    def progress(self, trial: int, trials: int, phase: str, share: float, time_left: float, duration: float) -> None:
        """How far the run is: trial from 0, `share` 0..1; `left`, and the command's `duration`, in s."""
        self._state.put(RunPart(self._sequence, trial, trials, phase, round(share, 3), round(time_left, 1), duration))

    def played(self, success: bool, message: str, bags: Sequence[str]) -> None:
        """The run ended, with these bags."""
        real = tuple(bag for bag in bags if bag.endswith("_real"))
        self._bags = real or self._bags
        self._move_values()
        self._state.note(message, "info" if success else "error")

    def loaded(self, success: bool, message: str) -> None:
        """The simulation answered whether it runs the model."""
        self._loading = False
        if not success:
            self._steps.announce(BY_HAND, None)
        self._state.note(message, "info" if success else "error")

    def close(self) -> None:
        """Interrupts the current job."""
        self._work.close()
        self._reruns.close()

    @property
    def _model(self) -> str:
        return self._steps.file or self._given_model

    def _move_values(self) -> None:
        """Offers the values of the running model to be varied on the last run."""
        try:
            self._reruns.use(tuple(map(Path, self._bags)), self._model)
        except InputError as error:
            self._state.note(f"No value can be moved: {error}", "error")

    def _do(self, request: Request) -> None:
        match request:
            case ArmRequest(on):
                self._armed = on
                self._state.note("The rig is armed: Play moves it." if on else "The rig is no longer armed.")
            case StopRequest():
                self._rig.stop()
                self._work.stop()
            case PlayRequest():
                self._play(request)
            case DiagnoseRequest():
                bags, model = self._materials()
                out = self._new("diagnosis")
                self._work.start(DiagnoseTask(bags=bags, model=model, out=out, candidates=self._candidates))
            case AddRequest(names):
                self._registry.check(names)
                bags, model = self._materials()
                first = Path(model).stem if not self._made["model"] else Path(model).stem.rpartition("_")[0]
                out = self._new("model", f"{first}_{{}}.yaml")
                self._work.start(AddTask(bags=bags, model=model, out=out, names=names))
                self._adding = " + ".join(names)

    def _play(self, request: PlayRequest) -> None:
        self._refuse_when_busy()
        if not self._armed:
            raise InputError("Arm the rig first: playing moves it.")
        if not self._rig.ready:
            raise InputError("No player is running. Start `ros2 run eps_tunnel_analysis player`.")
        # A path that came over the wire is not looked up: what is offered is all there is.
        if request.sequence not in self._offered:
            raise InputError(unknown_name("sequence", request.sequence, self._offered))
        sequence = find_sequence(request.sequence)
        self._sequence, self._began = sequence.name, time.monotonic()
        self.progress(0, (request.trials or sequence.trials) * len(sequence.commands), "connecting", 0.0, 0.0, 0.0)
        self._reruns.end()
        self._rig.play(request.sequence, request.trials, self._new("play"))

    def _materials(self) -> tuple[tuple[Path, ...], str]:
        """Bags and model to work with."""
        self._refuse_when_busy()
        if not self._bags:
            raise InputError("Play a sequence first: the diagnosis uses the bags of the last run.")
        if not self._model:
            raise InputError("The simulation does not report its model's file. Name it: `-p model:=...`.")
        return tuple(map(Path, self._bags)), self._model

    def _refuse_when_busy(self) -> None:
        if self._rig.playing or self._work.kind or self._loading:
            raise InputError("Wait until the current job has ended, or stop it.")

    def _new(self, kind: str, name: str = "") -> Path:
        """An unused path in a folder of this session."""
        if self._folder is None:
            self._folder = numbered_folder(self._out, "monitor", "`-p folder:=...`")
        self._made[kind] += 1
        return self._folder / (name or f"{kind}-{{}}").format(self._made[kind])

    def _worked(self, out: Path, content: dict[str, Any] | None, kind: str, complaint: str) -> None:
        if content is None:
            self._state.note(complaint, "error")
        elif kind == "diagnose":
            self._diagnosed(out, content)
        else:
            self._steps.announce(f"+ {self._adding}", content["after"]["held_out"])
            self._state.note(content["sentence"])
            self._loading, self._began = True, time.monotonic()
            self._rig.load(out)

    def _diagnosed(self, folder: Path, content: dict[str, Any]) -> None:
        number = len(self.reports) + 1
        self.reports[number] = folder / "report.html"
        experiment = folder / EXPERIMENT
        if experiment.exists():
            self._experiments.insert(0, str(experiment))
            self._offer()
        self._state.put(verdict_of(content, f"/report/{number}", str(experiment) if experiment.exists() else ""))
        self._steps.diagnosed(content["held_out_as_given"])
        self._state.note(content["sentence"])
        self._rig.publish(content, str(self.reports[number]))

    def _offer(self) -> None:
        """Shows the sequences that can be chosen: those proposed by diagnoses, and all named ones."""
        sequences = []
        for name in (*self._experiments, *config.names("sequences")):
            try:
                sequence = find_sequence(name)
            except InputError as error:
                self._state.note(str(error), "error")
                continue
            duration = sum(command.duration for command in sequence.commands)
            sequences.append((name, sequence.description, sequence.trials, duration))
        self._offered = tuple(name for name, *_ in sequences)
        names = sorted(n for n, e in self._registry.effects.items() if not e.nameless)
        self._state.put(Choices(tuple(sequences), tuple(names)))

    def _disarm_unwatched(self, pages: int) -> None:
        now = time.monotonic()
        if pages or self._rig.playing:
            self._watched = now
        elif self._armed and now - self._watched > UNWATCHED:
            self._armed = False
            self._state.note("No page is open any more, so the rig is no longer armed.")

    def _show(self) -> None:
        rig = self._rig
        self._state.put(
            Connections(
                real=rig.alive("real"), sim=rig.alive("sim"), player=rig.ready, analysis=rig.analysed,
                model=self._steps.model, file=self._model, armed=self._armed,
            )
        )  # fmt: skip
        kind, doing, began = self._work.kind, self._work.doing, self._work.began
        if rig.playing:
            kind, doing, began = "play", "", self._began
        elif self._loading:
            kind, doing, began = "add", "loading the model", self._began
        self._state.put(Job(kind, doing, float(round(time.monotonic() - began)) if kind else 0.0))


@dataclass(frozen=True)
class _Wanted:
    """A value to try on some recordings; `turn` says whether it was ended in the meantime."""

    bags: tuple[Path, ...]
    model: str
    adjustable: Adjustable
    value: float | None
    turn: int


class Reruns:
    """Simulates the last command of a run again while a value of the model is varied, in a separate thread.

    Of several waiting requests only the newest is done. May be used from any thread.
    """

    def __init__(self, state: State) -> None:
        self._state = state
        self._lock = threading.Lock()
        self._threads = ThreadPoolExecutor(1, "rerun")
        self._bags, self._model = tuple[Path, ...](), ""
        self._offered = dict[str, Adjustable]()
        self._wanted: _Wanted | None = None
        self._turn = self._number = 0
        # Of the worker's thread alone:
        self._prepared: tuple[tuple[Path, ...], str, WhatIf] | None = None

    def use(self, bags: Sequence[Path], model: str) -> None:
        """Uses these recordings and this model from now on; nothing if one of them is missing.

        Raises:
            InputError: the model cannot be read.
        """
        offered = adjustable(load_model(model)) if bags and model else ()
        with self._lock:
            self._bags, self._model = tuple(bags), model
            self._offered = {a.name: a for a in offered}
        self.end()
        self._state.put(Adjustables(offered))

    def ask(self, name: str, value: float | None) -> None:
        """Changes a value, None to the model's own; the answer is shown in the state, a complaint in its log.

        Raises:
            InputError: nothing is recorded yet, or the name is not offered.
        """
        with self._lock:
            if not self._offered:
                raise InputError("Play a sequence first: a value is tried on the recordings of the last run.")
            if name not in self._offered:
                raise InputError(unknown_name("parameter", name, self._offered))
            self._wanted = _Wanted(self._bags, self._model, self._offered[name], value, self._turn)
        self._threads.submit(self._next)

    def end(self) -> None:
        """Removes the answer, and drops one that is being computed."""
        with self._lock:
            self._wanted = None
            self._turn += 1
            self._state.show_what_if(WhatIfPart(), None)

    def close(self) -> None:
        """Waits until the current one is done."""
        with self._lock:
            self._wanted = None
        self._threads.shutdown()

    def _next(self) -> None:
        with self._lock:
            wanted, self._wanted = self._wanted, None
        if wanted is None:
            return
        try:
            prepared = self._prepare(wanted)
            changed = None if wanted.value is None else prepared.with_value(wanted.adjustable.name, wanted.value)
            table = _table(prepared, changed)
        except Exception as error:  # a thread that died silently would leave the page waiting for ever
            known = isinstance(error, InputError | OSError)
            self._state.note(str(error) if known else f"It failed: {error!r}.", "error")
            return
        with self._lock:
            if wanted.turn == self._turn:
                self._number += 1
                part = _part(prepared, changed, wanted, self._number)
                self._state.show_what_if(part, {**table, "number": self._number})

    def _prepare(self, wanted: _Wanted) -> WhatIf:
        """Raises InputError."""
        if self._prepared is None or self._prepared[:2] != (wanted.bags, wanted.model):
            recorded = load_recorded(wanted.model, wanted.bags)
            self._prepared = (wanted.bags, wanted.model, WhatIf(recorded.model, recorded.plays[-1]))
        return self._prepared[2]


def _part(prepared: WhatIf, changed: WhatIfAnswer | None, wanted: _Wanted, number: int) -> WhatIfPart:
    moved, name, shown = wanted.adjustable, prepared.model.name, changed or prepared.given
    value = moved.given if wanted.value is None else wanted.value
    model = f"{name} with {moved.name} {shown_number(value, 4)} {moved.unit}".removesuffix(" 1") if changed else name
    gap = GapPart(
        model=model,
        signals=prepared.tunnel.signals,
        ks=prepared.ks,
        shares=tuple(tuple(a.shares[s] for a in shown.alikeness) for s in prepared.tunnel.signals),
        joint=tuple(a.joint for a in shown.alikeness),
        rig=tuple(one.joint for one in prepared.itself),
        rig_shares=tuple(tuple(one.shares[s] for one in prepared.itself) for s in prepared.tunnel.signals),
        samples=len(prepared.tunnel.time),
        trials=prepared.tunnel.trials,
    )
    before = Before(name, prepared.ks, tuple(a.joint for a in prepared.given.alikeness)) if changed else None
    return WhatIfPart(moved.name, moved.unit, value, moved.given, prepared.play.name, gap, before, number)


def _table(prepared: WhatIf, changed: WhatIfAnswer | None) -> dict[str, Any]:
    """The trajectories in the format of `TunnelTable.changes`; with the changed one also that of the model as it is."""
    tunnel, shown = prepared.tunnel, changed or prepared.given
    values = np.full((*tunnel.mean.shape, 5), np.nan)
    values[..., :SIMULATED] = np.stack([tunnel.mean, *tunnel.bounds()], axis=-1)
    values[..., SIMULATED] = shown.simulated
    if changed:
        values[..., BEFORE] = prepared.given.simulated
    least = shown.alikeness[0]
    judged = least.alike.astype(np.int8) if tunnel.trials >= TUNNEL_TRIALS else COLLECTING
    inside = np.where(least.seen, judged, NOT_SEEN).astype(np.int8)
    return {
        "key": "what if", "signals": list(tunnel.signals), "step": tunnel.step, "duration": float(tunnel.time[-1]),
        "whole": True, "rows": table_rows(range(len(tunnel.time)), values, inside),
    }  # fmt: skip
