# SPDX-License-Identifier: Apache-2.0
"""Work on bags that a node hands to a process of its own: what is wanted travels as typed values, not as options.

`python -m eps_tunnel_analysis.tasks` reads one task as JSON from stdin, prints the result as JSON, and its progress by
lines of JSON on stderr. Exit codes are those of the command line.
"""

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from eps_tunnel_analysis.outputs import json_text
from eps_tunnel_analysis.processes import (
    BAD_INPUT,
    INTERRUPTED,
    TIMING,
    CommandResult,
    run_program,
    spare_threads,
)
from eps_tunnel_analysis.terminal import fit_bars, rollout_progress
from labyrinth_sim.errors import InputError
from labyrinth_sim.registry import Registry


class _Task(BaseModel):
    """What every task is given.

    Attributes:
        bags: of the real rig.
        model: name or path.
        out: what is written; must not exist.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)
    bags: tuple[Path, ...]
    model: str
    out: Path


class DiagnoseTask(_Task):
    """A diagnosis of the bags into the folder `out`; the result is the content of its diagnosis.json.

    Attributes:
        candidates: names of effects to consider; none for all.
        timing: s, uneven timing within trials that the rig is known to have.
    """

    kind: Literal["diagnose"] = "diagnose"
    candidates: tuple[str, ...] = ()
    seed: int = 0
    timing: float = TIMING

    def run(self) -> dict[str, Any]:
        """Raises InputError."""
        from eps_tunnel_analysis.loop.reason import DiagnosisOptions, DiagnosisRun, diagnose_bags

        Registry.load().check(self.candidates)
        options = DiagnosisOptions(self.candidates or None, self.seed, spare_threads(), self.timing)
        with rollout_progress("lines") as progress:
            return dict(diagnose_bags(self.model, self.bags, self.out, options, DiagnosisRun(progress)).content)


class AddTask(_Task):
    """Effects added to the model and fitted to the bags; the new model is the file `out`.

    Attributes:
        names: `EFFECT.PLACE`.
    """

    kind: Literal["add"] = "add"
    names: tuple[str, ...]

    def run(self) -> dict[str, Any]:
        """Raises InputError."""
        from eps_tunnel_analysis.loop.reason import DiagnosisOptions, add_to_model

        Registry.load().check(self.names)
        options = DiagnosisOptions(threads=spare_threads())
        with rollout_progress("lines") as progress:
            addition, _ = add_to_model(self.model, self.bags, self.names, self.out, options, progress)
        return {"model": str(self.out), **addition.to_json()}


class CalibrateTask(_Task):
    """A fit of the model's values to the bags; the fitted model is the file `out`.

    Attributes:
        free: patterns of the values to fit; none for those that the model's drives declare as free.
        signals: to fit; none for every position.
    """

    kind: Literal["calibrate"] = "calibrate"
    seed: int = 0
    method: Literal["cma", "es", "gauss-newton"] = "gauss-newton"
    fitness: Literal["error", "srg"] = "error"
    free: tuple[str, ...] = ()
    signals: tuple[str, ...] = ()

    def run(self) -> dict[str, Any]:
        """Raises InputError."""
        from eps_tunnel_analysis.calibration.calibrate import Settings
        from eps_tunnel_analysis.calibration.from_bags import calibrate_bags, free_of, model_and_result
        from eps_tunnel_analysis.inputs import Reading, hold_out, load_recorded

        files = model_and_result(self.out)
        signals = self.signals or None
        recorded = load_recorded(self.model, self.bags, Reading(signals=signals))
        free = free_of(recorded, self.free, self.signals)
        settings = Settings(
            method=self.method, fitness=self.fitness, seed=self.seed, signals=signals,
            held_out=hold_out(recorded.plays, None, self.seed), nthread=spare_threads(),
        )  # fmt: skip
        with fit_bars("lines") as bars:
            return calibrate_bags(recorded, free, settings, self.method == "es", files, bars).content


Task = Annotated[DiagnoseTask | AddTask | CalibrateTask, Field(discriminator="kind")]
_TASKS: TypeAdapter[DiagnoseTask | AddTask | CalibrateTask] = TypeAdapter(Task)


def run_task(
    task: DiagnoseTask | AddTask | CalibrateTask,
    progress: Callable[[dict[str, Any]], None],
    stopped: Callable[[], bool],
) -> CommandResult:
    """Does a task in a process of its own; see `run_program` for `progress` and `stopped`."""
    return run_program("eps_tunnel_analysis.tasks", task.model_dump_json(), progress, stopped)


def task_complaint(error: ValidationError) -> str:
    """What is wrong with the values of a task, in words."""
    return "\n".join(f"{'.'.join(map(str, e['loc']))}: {e['msg']}, got {e['input']!r:.200}." for e in error.errors())


def main() -> int:
    """Does the task on stdin."""
    try:
        content = _TASKS.validate_json(sys.stdin.read()).run()
    except InputError as error:
        print("\n".join(error.complaints), file=sys.stderr)
        return BAD_INPUT
    except ValidationError as error:
        print(task_complaint(error), file=sys.stderr)
        return BAD_INPUT
    except OSError as error:
        print(f"{error.filename}: {error.strerror}" if error.filename else error, file=sys.stderr)
        return BAD_INPUT
    except KeyboardInterrupt:
        print("Interrupted.", file=sys.stderr)
        return INTERRUPTED
    print(json_text(content), end="")
    return INTERRUPTED if content.get("interrupted") else 0


if __name__ == "__main__":
    sys.exit(main())
