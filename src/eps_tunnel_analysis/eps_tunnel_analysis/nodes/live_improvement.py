# SPDX-License-Identifier: Apache-2.0
"""The experimenter's loop over ROS: on the nodes that run, or on an emulated rig of its own."""

import os
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from eps_tunnel_analysis.autonomous.experimenter import Ending, Experimenter, Plan
from eps_tunnel_analysis.autonomous.notebook import Notebook
from eps_tunnel_analysis.autonomous.rig import RigFailed
from eps_tunnel_analysis.autonomous.truth import judged, told
from eps_tunnel_analysis.cli.diagnosing import progress
from eps_tunnel_analysis.nodes.processes import ProcessDied
from eps_tunnel_analysis.nodes.rig_client import RigClient
from eps_tunnel_analysis.nodes.rig_processes import EmulatedRig, hidden_in, rig_processes
from labyrinth_sim.errors import InputError
from labyrinth_sim.model import load_model


@dataclass(frozen=True)
class Asked:
    """What was asked for.

    Attributes:
        folder: must not exist.
        emulated: name or path of a config/testbed file, or None to join the nodes that run.
        hidden: effects to hide in the emulated rig.
        seed: of the emulated rig's noise, and of a draw.
        progress: "bar" or "lines".
        say: told a line for each entry of the notebook.
    """

    plan: Plan
    folder: Path
    emulated: str | None
    hidden: tuple[str, ...]
    seed: int
    progress: str
    say: Callable[[str], None]


def improve(asked: Asked) -> Ending:
    """Runs the loop and keeps its notebook.

    Raises:
        InputError: bad input, told before anything moves.
        RigFailed: the rig, or a node of it, ended. The notebook is whole then, as after Ctrl-C.
    """
    model = load_model(asked.plan.model)
    try:
        asked.folder.mkdir(parents=True)
    except OSError as error:
        raise InputError(f"--out {asked.folder}: cannot be made ({error.strerror}). Name another folder.") from error
    where = f"the emulated rig '{asked.emulated}'" if asked.emulated else "the rig whose nodes run"
    plan = asked.plan
    notebook = Notebook(
        asked.folder, f"What {model.name} lacks",
        f"Model '{model.name}' of rig '{model.rig.name}': {model.description}",
        f"Played on {where} and on its simulation: {plan.sequence}, {plan.trials} trials each time. At most "
        f"{plan.most_steps} additions. Seed {asked.seed}.",
    )  # fmt: skip
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        with _rig(asked) as rig:
            ending = Experimenter(
                rig, plan, asked.folder, notebook, asked.say, lambda: progress(asked.progress)
            ).run()  # fmt: skip
    except ProcessDied as died:
        raise RigFailed(str(died)) from died
    if asked.emulated:
        hidden = hidden_in(asked.folder)
        verdict = f"Hidden in the testbed: {told(hidden)}."
        right = judged(hidden, ending.effects, ending.verdict, ending.stated)
        notebook.entry("What was hidden", f"{verdict} **{right}**")
        asked.say(f"{verdict} {right}")
    asked.say(f"Notebook: {notebook.path.resolve()}")
    return ending


@contextmanager
def _rig(asked: Asked) -> Iterator[RigClient]:
    if asked.emulated is None:
        with RigClient() as client:
            yield client
        return
    emulated = EmulatedRig(asked.emulated, asked.emulated, asked.hidden, asked.seed)
    with rig_processes(emulated, asked.plan.model, asked.folder) as processes:

        def watch() -> None:
            try:
                processes.check()
            except ProcessDied as died:
                raise RigFailed(str(died)) from died

        asked.say(f"The rig runs. To watch it: export ROS_DOMAIN_ID={os.environ['ROS_DOMAIN_ID']}")
        with RigClient(watch) as client:
            yield client
