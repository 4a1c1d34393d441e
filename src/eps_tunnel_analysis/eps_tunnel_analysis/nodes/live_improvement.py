# SPDX-License-Identifier: Apache-2.0
"""The loop over ROS: on the nodes that run, or on an emulated rig of its own."""

import os
import signal
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path

from eps_tunnel_analysis.diagnose.progress import RolloutProgress
from eps_tunnel_analysis.loop.experimenter import Ending, Experimenter, Plan
from eps_tunnel_analysis.loop.notebook import Notebook
from eps_tunnel_analysis.loop.rig import RigFailed
from eps_tunnel_analysis.loop.truth import judged
from eps_tunnel_analysis.nodes.rig_client import RigClient
from eps_tunnel_analysis.nodes.rig_processes import EmulatedRig, hidden_in, hidden_in_words, rig_processes
from eps_tunnel_analysis.processes import ProcessDied
from labyrinth_sim.errors import InputError
from labyrinth_sim.model import load_model


def improve(
    plan: Plan,
    folder: Path,
    emulated: str | None,
    hidden: tuple[str, ...],
    progress: Callable[[], AbstractContextManager[RolloutProgress | None]],
    say: Callable[[str], None],
) -> Ending:
    """Runs the loop and keeps its notebook.

    Args:
        folder: must not exist.
        emulated: name or path of a config/testbed file, or None to join the nodes that run.
        hidden: effects to hide in the emulated rig; the seed of its noise is that of the plan's diagnoses.
        say: called with a line for each entry of the notebook.

    Raises:
        InputError: bad input, before anything moves.
        RigFailed: the rig, or a node of it, ended. The notebook is whole then, as after Ctrl-C.
    """
    model, seed = load_model(plan.model), plan.search.seed
    try:
        folder.mkdir(parents=True)
    except OSError as error:
        raise InputError(f"--out {folder}: cannot be made ({error.strerror}). Name another folder.") from error
    where = f"the emulated rig '{emulated}'" if emulated else "the rig whose nodes run"
    notebook = Notebook(
        folder, f"What {model.name} lacks",
        f"Model '{model.name}' of rig '{model.rig.name}': {model.description}",
        f"Played on {where} and on its simulation: {plan.sequence}, {plan.trials} trials each time. At most "
        f"{plan.most_steps} additions. Seed {seed}.",
    )  # fmt: skip
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    rig_to_emulate = EmulatedRig(emulated, emulated, hidden, seed) if emulated else None
    with rig_over_ros(rig_to_emulate, plan.model, folder) as rig:
        if emulated:
            say(f"The rig runs. To watch it: export ROS_DOMAIN_ID={os.environ['ROS_DOMAIN_ID']}")
        ending = notebook.keep(Experimenter(plan, folder, rig, progress).steps(), say)
    if emulated:
        revealed = hidden_in(folder)
        text = f"Hidden in the testbed: {hidden_in_words(revealed)}."
        right = judged(revealed, ending.effects, ending.verdict, ending.stated, model.registry)
        notebook.entry("What was hidden", f"{text} **{right}**")
        say(f"{text} {right}")
    say(f"Notebook: {notebook.path.resolve()}")
    return ending


@contextmanager
def rig_over_ros(emulated: EmulatedRig | None, model: str, folder: Path) -> Iterator[RigClient]:
    """A rig to play on, until the end of the block: the nodes that run, or an emulated rig with its own.

    Raises:
        InputError: the testbed refuses what it was given.
        RigFailed: a process of the emulated rig ended.
    """
    if emulated is None:
        with RigClient() as client:
            yield client
        return
    try:
        with rig_processes(emulated, model, folder) as processes:

            def watch() -> None:
                try:
                    processes.check()
                except ProcessDied as died:
                    raise RigFailed(str(died)) from died

            with RigClient(watch) as client:
                yield client
    except ProcessDied as died:
        raise RigFailed(str(died)) from died
