# SPDX-License-Identifier: Apache-2.0
"""The MuJoCo simulation as a managed ROS node, with the topics and the lifecycle of the real rig.

Configured, it simulates and publishes. Active, it is armed: it obeys commands. A simulation can harm nothing, so it
starts armed, and does not disarm itself. Paused, it stands still with all that it has; so does its /clock.
"""

import signal
import sys
import time
from collections.abc import Sequence
from typing import Any

import numpy as np
import rclpy
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.clock import Clock, ClockType
from rclpy.executors import ExternalShutdownException
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.qos_overriding_options import QoSOverridingOptions
from rosgraph_msgs.msg import Clock as ClockMessage
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from std_srvs.srv import SetBool, Trigger

from labyrinth_msgs.msg import BallEvent, BallState, RunningModel
from labyrinth_msgs.srv import LoadModel, StepSimulation
from labyrinth_sim.ball import ON_BOARD, OVER_THE_RIM, BallGame
from labyrinth_sim.errors import InputError, unknown_name
from labyrinth_sim.model import Model, load_model
from labyrinth_sim.nodes.start import start_ros, waiting
from labyrinth_sim.rig import BALL_SIGNALS
from labyrinth_sim.stepping import Stepper
from labyrinth_sim.urdf import urdf

CATCH_UP = 0.25  # s; a longer hiccup is skipped rather than caught up
MOST_STEPS = 100_000  # samples in one call of step
BUILT_IN = ("use_sim_time", "start_type_description_service", "qos_overrides.")


class SimNode(LifecycleNode):
    """Runs one model in real time, or at a multiple of it, and publishes what its sensors see."""

    def __init__(self) -> None:
        super().__init__("sim_node")
        self._declare("model", "labyrinth", "name or path of the model [-]", changes=True)
        self._declare("side", "sim", "prefix of the topics, within the node's namespace [-]")
        self._declare("rate", 0.0, "samples per second; 0 for the rig's [Hz]", low=0.0, high=1000.0)
        self._declare("real_time_factor", 1.0, "seconds simulated per second; /clock is published where not 1 [1]",
                      low=0.01, high=100.0, changes=True)  # fmt: skip
        self._declare("publish_clock", False, "publish /clock and use it for stamps even if the factor is 1 [-]")
        self._declare("seed", 0, "seed of the sensors' noise [-]", low=0, high=2**31 - 1)
        self._declare("autostart", True, "configure at start; otherwise a lifecycle manager does it [-]")
        self._declare("arm", True, "activate at start, so that commands are executed [-]")
        self._declare("paused", False, "start paused [-]")
        self._declare("noise", 0.0, "standard deviation of the measured angles' noise [rad]", low=0.0, high=0.1,
                      changes=True)  # fmt: skip
        self._refuse_unknown_parameters()
        side = str(self.get_parameter("side").value).rstrip("/")
        rate = float(self.get_parameter("rate").value)
        self._factor = float(self.get_parameter("real_time_factor").value)
        self._noise = float(self.get_parameter("noise").value)
        self._random = np.random.default_rng(int(self.get_parameter("seed").value))
        self._rate = rate
        self._loaded = 0
        self._configured = self._active = False
        self._paused = bool(self.get_parameter("paused").value)
        self._model: Model
        self._stepper: Stepper
        self._next: tuple[Model, Stepper] | None = None  # what a new value of `model` was found to be
        model = load_model(str(self.get_parameter("model").value))
        self._use(model, self._stepper_of(model))
        topics = self._model.rig.topics
        self._states = self.create_publisher(JointState, f"{side}/{topics['states']}", **_qos())
        self._balls = self.create_publisher(BallState, f"{side}/{topics['ball']}", **_qos())
        self._events = self.create_publisher(BallEvent, f"{side}/{topics['ball_event']}", **_qos())
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        publishes = self._factor != 1.0 or self.get_parameter("publish_clock").value
        self._clocks = self.create_publisher(ClockMessage, "/clock", 10) if publishes else None
        self._models = self.create_publisher(RunningModel, f"{side}/model", _latched())
        self._descriptions = self.create_publisher(String, f"{side}/robot_description", _latched())
        self._commands = self.create_subscription(JointState, f"{side}/{topics['commands']}", self._command, **_qos())
        self.create_service(SetBool, f"{side}/arm", self._arm)
        self.create_service(Trigger, f"{side}/reset", self._reset)
        self.create_service(Trigger, f"{side}/supply_ball", self._supply)
        self.create_service(SetBool, f"{side}/pause", self._pause)
        self.create_service(StepSimulation, f"{side}/step", self._step)
        self.create_service(LoadModel, f"{side}/load_model", self._load)
        self.add_on_set_parameters_callback(self._may_change)
        self.add_post_set_parameters_callback(self._changed)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._ticker = self.create_timer(self._period, self._tick, clock=steady)
        self.create_timer(1.0, self._report, clock=steady)
        self._began, self._epoch = time.monotonic(), self.get_clock().now().nanoseconds
        self._done = 0  # samples simulated since the beginning
        self._skipped, self._late, self._refused = 0.0, 0, 0
        self._tell_model()
        self.get_logger().info(
            f"Simulates '{self._model.name}' at {1 / self._stepper.step:g} Hz under {self.resolve_topic_name(side)}."
        )

    def start(self) -> None:
        """Configure and arm as the parameters say."""
        if self.get_parameter("autostart").value:
            self.trigger_configure()
            if self.get_parameter("arm").value:
                self.trigger_activate()

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Simulate and publish, from rest."""
        self._rest()
        self._resume()
        self._configured = True
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Arm: commands are obeyed."""
        self._drop()  # what came before
        self._active = True
        return TransitionCallbackReturn.SUCCESS

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Disarm: the last command stays in force."""
        self._active = False
        return TransitionCallbackReturn.SUCCESS

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Neither simulate nor publish."""
        self._configured = self._active = False
        return TransitionCallbackReturn.SUCCESS

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """The same, for good."""
        return self.on_cleanup(state)

    def _arm(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        """The lifecycle's transitions, with a reason where they are refused."""
        if not self._configured:
            response.success, response.message = False, f"Configure {self.get_name()} first."
            return response
        if request.data and not self._active:
            self.trigger_activate()
        elif not request.data and self._active:
            self.trigger_deactivate()
        response.success = True
        response.message = "Armed: commands are executed." if request.data else "Disarmed: commands are refused."
        return response

    def _declare(
        self,
        name: str,
        default: object,
        text: str,
        low: float | None = None,
        high: float | None = None,
        changes: bool = False,
    ) -> None:
        about = ParameterDescriptor(description=text, read_only=not changes)
        if low is not None and high is not None:
            if isinstance(default, int):
                about.integer_range = [IntegerRange(from_value=int(low), to_value=int(high), step=1)]
            else:
                about.floating_point_range = [FloatingPointRange(from_value=low, to_value=high, step=0.0)]
        self.declare_parameter(name, default, about)

    def _refuse_unknown_parameters(self) -> None:
        known = [name for name in self._parameters if not name.startswith(BUILT_IN)]
        unknown = [n for n in self._parameter_overrides if not self.has_parameter(n) and not n.startswith(BUILT_IN)]
        if unknown:
            raise InputError([unknown_name("parameter", name, known) for name in unknown])

    @property
    def _period(self) -> float:
        """s between two looks at how far to simulate."""
        return min(self._stepper.step / self._factor, 0.02)

    def _stepper_of(self, model: Model) -> Stepper:
        return Stepper(model, 1.0 / self._rate if self._rate else None)

    def _use(self, model: Model, stepper: Stepper) -> None:
        """Starts a model from rest."""
        self._target = np.zeros(len(model.rig.command_channels))
        self._last = stepper.reset()
        self._model, self._stepper = model, stepper
        self._lost, self._game = False, _game(stepper)

    def _replace(self, model: Model, stepper: Stepper) -> None:
        """Goes on with another model from the pose and the commands of now."""
        self._last = stepper.reset(self._pose())
        self._model, self._stepper = model, stepper
        self._lost, self._game = False, _game(stepper)
        self._loaded += 1
        self._tell_model()  # whoever compares should know before the next trial
        self._report()
        self.get_logger().info(f"Simulates '{model.name}' now.")

    def _tell_model(self) -> None:
        message = RunningModel(name=self._model.name, file=str(self._model.path or ""), loaded=self._loaded)
        message.header.stamp = self.get_clock().now().to_msg()
        self._models.publish(message)
        self._descriptions.publish(String(data=urdf(self._model.rig)))

    def _pose(self) -> dict[str, float]:
        now = dict(zip(self._stepper.signals, self._last, strict=True))
        ball = BALL_SIGNALS if self._stepper.with_ball and not self._lost else ()
        return {name: float(now[name]) for name in (*self._model.rig.positions, *ball)}

    def _command(self, message: JointState) -> None:
        channels = self._model.rig.command_channels
        names, angles = list(message.name), np.array(message.position, float)
        unknown = [n for n in names if n not in channels]
        if not self._active:
            self._refused += 1
            self.get_logger().warning(
                f"Refused a command: the simulation is disarmed. To arm it, activate {self.get_name()} or call NS/arm.",
                throttle_duration_sec=1.0,
            )
            return
        if not names or unknown or len(names) != len(angles) or not np.isfinite(angles).all():
            self._refused += 1
            self.get_logger().warning(
                f"Refused a command with names {names} and {len(angles)} positions; expected finite positions "
                f"(rad) for some of {', '.join(channels)}.",
                throttle_duration_sec=1.0,
            )
            return
        for name, angle in zip(names, angles, strict=True):
            axis = self._model.rig.axes[channels.index(name)]
            self._target[channels.index(name)] = np.clip(angle, *axis.limits)

    def _drop(self) -> None:
        for _ in waiting(self._commands):
            self._refused += 1

    def _hear(self) -> None:
        """Takes all commands that wait: the executor takes one at a time, and what piled up once would stay late."""
        for message in waiting(self._commands):
            self._command(message)

    def _tick(self) -> None:
        """Simulates up to now; counts samples from the beginning, so that nothing drifts."""
        self._hear()
        if not self._configured or self._paused:
            return
        step = self._stepper.step
        due = int(self._passed() / step) - self._done
        most = max(1, int(CATCH_UP * max(self._factor, 1.0) / step))
        if due > most:
            self._skipped += (due - most) * step
            self._late += due - most
            due = most
        for _ in range(due):
            self._sample()

    def _passed(self) -> float:
        """s to be simulated since the beginning."""
        return (time.monotonic() - self._began) * self._factor - self._skipped

    def _resume(self) -> None:
        """Leaves out the time that has passed without being simulated; stamps never go back."""
        self._skipped = max(self._skipped, self._skipped + self._passed() - self._done * self._stepper.step)

    def _pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        if self._paused and not request.data:
            self._resume()
        self._paused = request.data
        response.success, response.message = True, f"{'Paused' if self._paused else 'Running'}: {self._where()}"
        return response

    def _step(self, request: StepSimulation.Request, response: StepSimulation.Response) -> StepSimulation.Response:
        if not self._configured or not self._paused:
            reason = f"Pause it first, by {self._commands.topic_name.rpartition('/')[0]}/pause."
            response.message = reason if self._configured else f"Configure {self.get_name()} first."
        elif request.samples > MOST_STEPS:
            response.message = f"{request.samples} samples in one call; expected {MOST_STEPS} at most."
        else:
            self._hear()
            for _ in range(max(1, request.samples)):
                self._sample()
            response.success, response.message = True, self._where()
        return response

    def _where(self) -> str:
        return f"{self._done} samples of {self._stepper.step:g} s simulated."

    def _sample(self) -> None:
        self._done += 1
        try:
            self._last = self._stepper.advance(self._target)
        except InputError as error:
            self.get_logger().error(f"{error} Starts again from rest.")
            self._last = self._stepper.reset()
        stamp = self._stamp()
        if self._clocks:
            self._clocks.publish(ClockMessage(clock=stamp))
        self._publish_joints(stamp)
        if self._stepper.with_ball:
            self._publish_ball(stamp)

    def _stamp(self) -> Time:
        # With a clock of its own time begins at zero and passes as it is simulated, whatever is skipped.
        skipped, start = (self._skipped, self._epoch) if self._clocks is None else (0.0, 0)
        nanoseconds = start + round((self._done * self._stepper.step + skipped) * 1e9)
        return Time(sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)

    def _publish_joints(self, stamp: Time) -> None:
        message = JointState()
        message.header.stamp = stamp
        seen = dict(zip(self._stepper.signals, self._last, strict=True))
        by_joint: dict[str, dict[str, float]] = {}
        for m in self._model.rig.measured:
            by_joint.setdefault(m.joint, {})[m.quantity] = float(seen[m.signal])
        shafts = {axis.joint: axis.command for axis in self._model.rig.axes}
        for joint in sorted(by_joint, key=lambda joint: joint not in shafts):  # as the rig has them: motors first
            numbers = by_joint[joint]
            message.name.append(shafts.get(joint, joint))
            noise = self._noise * self._random.standard_normal() if self._noise else 0.0
            message.position.append(numbers.get("position", float("nan")) + noise)
            message.velocity.append(numbers.get("velocity", float("nan")))
            message.effort.append(numbers.get("torque", float("nan")))
        self._states.publish(message)

    def _publish_ball(self, stamp: Time) -> None:
        message = BallState(visible=not self._lost)
        message.header.stamp, message.header.frame_id = stamp, "board_origin"
        message.x, message.y = (float(v) for v in self._last[-2:])
        if self._game and not self._lost:
            hole = int(self._game.loss(self._game.position(self._stepper.qpos)))
            if hole != ON_BOARD:
                self._lost, message.visible = True, False
                self._event(stamp, BallEvent.LOST, -1 if hole == OVER_THE_RIM else hole)
        self._balls.publish(message)

    def _event(self, stamp: Time, kind: int, hole: int) -> None:
        event = BallEvent(kind=kind, hole=hole)
        event.header.stamp, event.header.frame_id = stamp, "board_origin"
        self._events.publish(event)

    def _reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._rest()
        response.success, response.message = True, f"'{self._model.name}' starts again from rest."
        return response

    def _rest(self) -> None:
        self._target[:] = 0.0
        self._last, self._lost = self._stepper.reset(), False

    def _supply(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        try:
            self._stepper.supply_ball()
        except InputError as error:
            response.success, response.message = False, str(error)
            return response
        self._lost = False
        self._event(self._stamp(), BallEvent.SUPPLIED, -1)
        response.success, response.message = True, "The ball is at the start."
        return response

    def _load(self, request: LoadModel.Request, response: LoadModel.Response) -> LoadModel.Response:
        done = self.set_parameters([Parameter("model", value=request.model)])[0]
        response.success = done.successful
        response.message = f"Simulates '{self._model.name}' now." if done.successful else done.reason
        return response

    def _may_change(self, parameters: list[Parameter]) -> SetParametersResult:
        """Whether new values will do; a model is compiled here, so that what is taken over works."""
        for parameter in parameters:
            try:
                if parameter.name == "model":
                    self._next = self._compatible(str(parameter.value))
                if parameter.name == "real_time_factor" and self._clocks is None and parameter.value != 1.0:
                    raise InputError(
                        "This node started without /clock, so its stamps are those of real time. Start it with "
                        "another real_time_factor or with publish_clock:=true."
                    )
            except InputError as error:
                return SetParametersResult(successful=False, reason=f"{error} '{self._model.name}' goes on.")
        return SetParametersResult(successful=True)

    def _compatible(self, name: str) -> tuple[Model, Stepper]:
        model = load_model(name)
        stepper = self._stepper_of(model)
        if model.rig.command_channels != self._model.rig.command_channels or stepper.step != self._stepper.step:
            raise InputError(f"'{model.name}' has other command channels or another rate than the running model.")
        return model, stepper

    def _changed(self, parameters: list[Parameter]) -> None:
        for parameter in parameters:
            if parameter.name == "model" and self._next is not None:
                (model, stepper), self._next = self._next, None
                self._replace(model, stepper)
            elif parameter.name == "noise":
                self._noise = float(parameter.value)
            elif parameter.name == "real_time_factor":
                simulated = self._passed()
                self._factor = float(parameter.value)
                self._skipped += self._passed() - simulated
                self._ticker.timer_period_ns = int(self._period * 1e9)

    def _report(self) -> None:
        if not self._configured:
            return
        if self._paused and self._clocks:  # nodes that start in the meantime need the time, too
            self._clocks.publish(ClockMessage(clock=self._stamp()))
        behind = self._late > 0
        status = DiagnosticStatus(
            level=DiagnosticStatus.WARN if behind else DiagnosticStatus.OK,
            name=f"{self.get_fully_qualified_name().strip('/')}: simulation",
            message=f"{self._late} samples were skipped" if behind else "in time",
            hardware_id="mujoco",
        )
        numbers = {
            "model": self._model.name,
            "model file": self._model.path or "",
            "models loaded": self._loaded,
            "state": "active" if self._active else "disarmed",
            "paused": self._paused,
            "samples": self._done,
            "samples skipped": self._late,
            "commands refused": self._refused,
            "real-time factor": self._factor,
        }
        status.values = [KeyValue(key=key, value=str(value)) for key, value in numbers.items()]
        message = DiagnosticArray(status=[status])
        message.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(message)
        self._late = 0


def _game(stepper: Stepper) -> BallGame | None:
    """The rules by which the ball is lost; None on a rig that is no labyrinth."""
    try:
        return BallGame.of(stepper.mj) if stepper.with_ball else None
    except InputError:
        return None


def _qos() -> dict[str, Any]:
    """A new profile for one entity, because rclpy's parameters change it and must not affect others."""
    return {
        "qos_profile": QoSProfile(depth=50),
        "qos_overriding_options": QoSOverridingOptions.with_default_policies(),
    }


def _latched() -> QoSProfile:
    return QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def main(args: Sequence[str] | None = None) -> None:
    """Runs the node until it is interrupted; exit code 2 for bad parameters."""
    # rclpy's own handlers would close the context under a callback that is still publishing.
    start_ros("sim_node", "Simulates a model, with the topics of the real rig.", sys.argv[1:] if args is None else args)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.default_int_handler)
    try:
        node = SimNode()
        node.start()
    except KeyboardInterrupt:
        rclpy.try_shutdown()
        return
    except Exception as error:  # parameters that ROS or we refuse
        print(f"sim_node: {error}", file=sys.stderr)
        rclpy.try_shutdown()
        sys.exit(2)
    try:
        rclpy.spin(node)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
