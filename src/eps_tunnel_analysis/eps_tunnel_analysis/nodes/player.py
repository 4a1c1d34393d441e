# SPDX-License-Identifier: Apache-2.0
"""Plays an action sequence on the rig and on its simulation simultaneously, from one clock."""

import math
import sys
import traceback
from collections.abc import Callable

from eps_tunnel_analysis.motion import RestWatch
from eps_tunnel_analysis.nodes.common import Handle, OneGoal, TunnelNode, run_node
from eps_tunnel_analysis.nodes.pace import Pace
from eps_tunnel_analysis.nodes.play import Limits, Outcome, Progress, ProgressBar, SequencePlayer
from eps_tunnel_analysis.nodes.rig_side import RecordClient, RigSide
from eps_tunnel_analysis.sequence_file import find_sequence
from labyrinth_msgs.action import PlaySequence
from labyrinth_sim.errors import InputError


class Player(TunnelNode):
    """Action server play_sequence; with the parameter `sequence` it plays that at once and ends."""

    def __init__(self) -> None:
        super().__init__("player")
        self._sequence = self.parameter(
            "sequence", "", "Sequence to play at once: a name or a path; empty: wait for goals"
        )
        self._trials = self.parameter("trials", 0, "Trials of each command; 0: as the sequence says", "-", 0, 100_000)
        autostart = self.parameter("autostart", True, "Play `sequence` at the start, then end")
        self._record = self.parameter("record", False, "Have the analysis node record one bag per side, at autostart")
        self._folder = self.parameter("folder", "", "Folder for the bags, at autostart; empty: a new one under out/")
        sides = self.sides()
        number = self.parameter
        number("rate", 100.0, "Commands per second", "Hz", 1, 1000, changes=True)
        number("limit_deg", 5.0, "Largest target angle in either direction", "deg", 0, 180, changes=True)
        number("return_speed_deg", 20.0, "Speed on the way to the start", "deg/s", 0.1, 1000, changes=True)
        number("rest_time", 0.5, "How long a side must be still to be at rest", "s", 0.05, 60, changes=True)
        number("rest_speed_deg", 0.3, "Below this speed a joint is at rest", "deg/s", 0.001, 100, changes=True)
        number("rest_timeout", 20.0, "Longest wait for rest before a trial", "s", 0.1, 3600, changes=True)
        number("silence_timeout", 1.0, "Longest silence of joint states", "s", 0.02, 60, changes=True)
        number("connect_timeout", 10.0, "Longest wait for sides and recorder to appear", "s", 0.1, 3600, changes=True)
        number(
            "stall_timeout", 0.1, "Longest pause within a trial before it is started again", "s", 0.02, 10, changes=True
        )
        self.check_parameters()
        pace = Pace(self.get_clock(), bool(self.get_parameter("use_sim_time").value))
        self._rigs = [RigSide(self, side, self._rest_watch(), pace) for side in sides]
        record = RecordClient(self, sides)
        self._play = SequencePlayer(self, self._rigs, record, pace, self._value("rate"), self._limits())
        self._goals = OneGoal(
            self, PlaySequence, "play_sequence",
            lambda goal: f"Refused to play '{goal.sequence}': another sequence is being played.", self._play_goal,
        )  # fmt: skip
        if self._sequence:
            # A wrong name ends the process now, not when the first goal comes.
            self._play.check(find_sequence(self._sequence))
            if autostart:
                self._goals.begin(self._autostart)

    def _value(self, name: str) -> float:
        return float(self.get_parameter(name).value or 0.0)

    def _limits(self) -> Limits:
        return Limits(
            angle=math.radians(self._value("limit_deg")),
            speed=math.radians(self._value("return_speed_deg")),
            rest_timeout=self._value("rest_timeout"),
            silence=self._value("silence_timeout"),
            connect_timeout=self._value("connect_timeout"),
            stall=self._value("stall_timeout"),
        )

    def _rest_watch(self) -> RestWatch:
        return RestWatch(self._value("rest_time"), math.radians(self._value("rest_speed_deg")))

    @property
    def busy(self) -> bool:
        return self._goals.busy

    def close(self) -> None:
        self._goals.close()

    def _play_goal(self, handle: Handle) -> None:
        goal: PlaySequence.Goal = handle.request

        def report(progress: Progress) -> None:
            feedback = PlaySequence.Feedback(trial=progress.trial, trials=progress.trials, phase=progress.phase)
            feedback.progress, feedback.time_left = progress.share, progress.time_left
            handle.publish_feedback(feedback)

        outcome = self._run(
            goal.sequence or self._sequence, goal.trials or self._trials, goal.record, goal.folder, report,
            lambda: self._goals.stopped(handle),
        )  # fmt: skip
        result = PlaySequence.Result(success=outcome.success, message=outcome.message, bags=list(outcome.bags))

        def finish(handle: Handle) -> PlaySequence.Result:
            self._goals.settle(handle, outcome.success)
            return result

        handle.execute(finish)

    def _run(
        self,
        name: str,
        trials: int,
        record: bool,
        folder: str,
        report: Callable[[Progress], None],
        stopped: Callable[[], bool],
    ) -> Outcome:
        # Parameters set since the last run apply from this run on.
        self._play.rate, self._play.limits = self._value("rate"), self._limits()
        for rig in self._rigs:
            rig.rest = self._rest_watch()
        try:
            if not name:
                raise InputError("No sequence named. Give the name or the path of one as the goal's `sequence`.")
            outcome = self._play.play(find_sequence(name), trials, record, folder, report, stopped)
        except InputError as error:
            outcome = Outcome(False, str(error), ())
        except Exception as error:  # a thread that died silently would leave the player busy for ever
            self.get_logger().error(traceback.format_exc())
            outcome = Outcome(False, f"The player failed: {error!r}. See its log.", ())
        self.say(outcome.success, outcome.message)
        return outcome

    def _autostart(self) -> None:
        try:
            with ProgressBar() as bar:
                outcome = self._run(
                    self._sequence, self._trials, self._record, self._folder, bar.show, self.stopping.is_set
                )
            for bag in outcome.bags:
                print(bag)
            if not outcome.success and not self.stopping.is_set():
                self.exit_code = 1
        finally:
            self._goals.free()
            self.stopping.set()


def main(args: list[str] | None = None) -> int:
    """Entry point of `ros2 run eps_tunnel_analysis player`."""
    # The thread that keeps the clock must not wait 5 ms for one that decodes a message.
    sys.setswitchinterval(0.0005)
    return run_node("player", "Plays an action sequence on the rig and on its simulation at once.", Player, args)


if __name__ == "__main__":
    sys.exit(main())
