# SPDX-License-Identifier: Apache-2.0
"""The loop over ROS: on the running nodes, or on its own emulated rig."""

import math
import os
import signal
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, suppress
from pathlib import Path
from types import TracebackType
from typing import Any

import rclpy
from rcl_interfaces.srv import GetParameters
from rclpy.action import ActionClient
from rclpy.signals import SignalHandlerOptions

from eps_tunnel_analysis.diagnose.progress import RolloutProgress
from eps_tunnel_analysis.loop.experimenter import Ending, Experimenter, Plan, judged
from eps_tunnel_analysis.loop.gap import Bags, RigFailed
from eps_tunnel_analysis.loop.notebook import Notebook
from eps_tunnel_analysis.nodes.answers import Meeting, Repeated
from eps_tunnel_analysis.nodes.messages import diagnosis_message, latched
from eps_tunnel_analysis.nodes.play import Progress, ProgressBar
from eps_tunnel_analysis.nodes.rig_processes import EmulatedRig, hidden_in, hidden_in_words, rig_processes
from eps_tunnel_analysis.processes import ProcessDied
from labyrinth_msgs.action import PlaySequence
from labyrinth_msgs.msg import Diagnosis
from labyrinth_msgs.srv import LoadModel
from labyrinth_sim.errors import InputError
from labyrinth_sim.model import load_model

PATIENCE = 90.0  # s, for a node to appear; a busy machine takes its time
CANCEL = 10.0  # s, for the player to end after it was asked to


class RigClient:
    """A rig whose nodes are running. Ctrl-C while it plays makes the player stop and close its bags.

    Args:
        watch: called several times a second while waiting; raises if waiting has become pointless.
    """

    def __init__(self, watch: Callable[[], None] = lambda: None) -> None:
        self._watch = watch
        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        self._node = rclpy.create_node("eps_tunnel")
        self._player = ActionClient(self._node, PlaySequence, "play_sequence")
        self._meeting = Meeting(self._node, self._player, "play_sequence")
        self._loader = self._node.create_client(LoadModel, "sim/load_model")
        self._limits = self._node.create_client(GetParameters, "player/get_parameters")
        self._verdicts = self._node.create_publisher(Diagnosis, "srg/diagnosis", latched())

    def play(self, sequence: str, trials: int, folder: Path) -> Bags:
        """Plays a sequence, by name or path, on both sides, with a bar; one bag per side into `folder`.

        Raises:
            RigFailed: with the player's message.
        """
        self._appear(self._meeting.done, "the player (/play_sequence)")
        goal = PlaySequence.Goal(sequence=sequence, trials=trials, record=True, folder=str(folder.resolve()))
        with ProgressBar() as bar:

            def show(message: Any) -> None:
                f = message.feedback
                bar.show(Progress(f.trial, f.trials, f.phase, f.progress, f.time_left))

            handle = self._await(self._player.send_goal_async(goal, feedback_callback=show))
            if not handle.accepted:
                raise RigFailed("The player refused: another sequence is being played.")
            ending = handle.get_result_async()
            try:
                result: PlaySequence.Result = self._await(ending).result
            except BaseException:
                with suppress(Exception):  # the node may be what died
                    handle.cancel_goal_async()
                    rclpy.spin_until_future_complete(self._node, ending, timeout_sec=CANCEL)
                raise
        if not result.success:
            raise RigFailed(result.message)
        bags = [Path(bag) for bag in result.bags]
        return Bags(*(tuple(bag for bag in bags if bag.name.endswith(f"_{side}")) for side in ("real", "sim")))

    def load(self, model: Path) -> None:
        """Loads a model file into the running simulation. Raises RigFailed with the simulation's message."""
        self._appear(self._loader.service_is_ready, "the simulation (/sim/load_model)")
        answer = self._await(Repeated(self._loader, LoadModel.Request(model=str(model.resolve()))))
        if not answer.success:
            raise RigFailed(answer.message)

    def limit(self) -> float:
        """The largest angle, rad, that the player lets a sequence command."""
        self._appear(self._limits.service_is_ready, "the player (/player/get_parameters)")
        answer = self._await(Repeated(self._limits, GetParameters.Request(names=["limit_deg"])))
        return math.radians(answer.values[0].double_value)

    def publish(self, content: Mapping[str, Any], report: Path) -> None:
        """Publishes a verdict, in the form of diagnosis.json, on /srg/diagnosis."""
        message = diagnosis_message(content, str(report.resolve()))
        message.header.stamp = self._node.get_clock().now().to_msg()
        self._verdicts.publish(message)

    def _appear(self, ready: Callable[[], bool], what: str) -> None:
        deadline = time.monotonic() + PATIENCE
        while not ready():
            self._watch()
            if time.monotonic() > deadline:
                raise RigFailed(
                    f"{what} did not appear within {PATIENCE:g} s. Start it, and check ROS_DOMAIN_ID on both sides."
                )
            rclpy.spin_once(self._node, timeout_sec=0.1)

    def _await(self, answer: Any) -> Any:
        while not answer.done():
            rclpy.spin_once(self._node, timeout_sec=0.5)
            self._watch()
        return answer.result()

    def __enter__(self) -> "RigClient":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._node.destroy_node()
        rclpy.try_shutdown()


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
        emulated: name or path of a config/testbed file, or None to use the running nodes.
        hidden: effects to hide in the emulated rig; the seed of its noise is that of the plan's diagnoses.
        say: called with a line for each entry of the notebook.

    Raises:
        InputError: bad input, before anything moves.
        RigFailed: the rig, or a node of it, ended. The notebook is complete then, as after Ctrl-C.
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
    """A rig to play on, until the end of the block: the running nodes, or an emulated rig with its own.

    Raises:
        InputError: the testbed refuses its input.
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
