# SPDX-License-Identifier: Apache-2.0
"""What the monitor asks of other nodes: the player to play, the simulation to run another model."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from rclpy.action import ActionClient
from rclpy.node import Node

from labyrinth_msgs.action import PlaySequence
from labyrinth_msgs.srv import LoadModel


class PlayerClient:
    """One run at a time.

    Attributes:
        playing: whether one was asked for and has not ended.
    """

    def __init__(
        self, node: Node, progress: Callable[[PlaySequence.Feedback], None],
        ended: Callable[[PlaySequence.Result], None],
    ) -> None:  # fmt: skip
        self._client = ActionClient(node, PlaySequence, "/play_sequence")
        self._progress, self._ended = progress, ended
        self._handle: Any = None
        self._stop = False
        self.playing = False

    @property
    def ready(self) -> bool:
        """Whether the player is there."""
        return bool(self._client.server_is_ready())

    def play(self, sequence: str, trials: int, folder: Path) -> None:
        """Plays and records; the end is told to `ended`."""
        self.playing, self._handle, self._stop = True, None, False
        goal = PlaySequence.Goal(sequence=sequence, trials=trials, record=True, folder=str(folder))
        future: Any = self._client.send_goal_async(goal, feedback_callback=lambda m: self._progress(m.feedback))
        future.add_done_callback(self._answered)

    def stop(self) -> None:
        """Has the run end early."""
        self._stop = True
        if self._handle is not None:
            self._handle.cancel_goal_async()

    def lost(self) -> None:
        """The player went away; its run will not be told to have ended."""
        self._end(PlaySequence.Result(success=False, message="The player went away while it played."))

    def _answered(self, future: Any) -> None:
        handle = future.result()
        if not handle.accepted:
            self._end(PlaySequence.Result(success=False, message="The player is busy with another run."))
            return
        self._handle = handle
        if self._stop:
            handle.cancel_goal_async()
        result: Any = handle.get_result_async()
        result.add_done_callback(lambda f: self._end(f.result().result))

    def _end(self, result: PlaySequence.Result) -> None:
        if self.playing:
            self.playing, self._handle = False, None
            self._ended(result)


class SimulationClient:
    """Has the simulation run another model."""

    def __init__(self, node: Node) -> None:
        self._client = node.create_client(LoadModel, "/sim/load_model")

    def load(self, model: Path, answered: Callable[[bool, str], None]) -> None:
        """`answered` gets whether it does, and the simulation's words."""
        if not self._client.service_is_ready():
            answered(False, f"Nobody offers /sim/load_model. The model is in {model}.")
            return
        future: Any = self._client.call_async(LoadModel.Request(model=str(model)))
        future.add_done_callback(lambda f: answered(f.result().success, f.result().message))
