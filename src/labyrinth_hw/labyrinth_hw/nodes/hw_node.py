# SPDX-License-Identifier: Apache-2.0
"""The real rig as a managed ROS node: the same topics as the simulation, under /real.

Configured, it measures and publishes. Active, it is armed: it executes commands and drives the servos. It deactivates
itself after silence, on an alarm, and when a second publisher of commands appears.
"""

import os
import signal
import sys
import threading
import time
import traceback
from collections.abc import Sequence
from difflib import get_close_matches
from types import FrameType
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor, SetParametersResult
from rclpy.clock import Clock, ClockType
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from rclpy.qos_overriding_options import QoSOverridingOptions
from sensor_msgs.msg import CameraInfo, Image, JointState
from std_srvs.srv import SetBool, Trigger

from labyrinth_hw.devices import ask_for_priority
from labyrinth_hw.errors import BusError, HardwareError, InputError
from labyrinth_hw.hardware import Hardware, Measurement, hardware_health
from labyrinth_hw.nodes.messages import Stamps, ball_state, board_state, camera_info, diagnostics, image, joint_state
from labyrinth_hw.nodes.start import spin, start_ros
from labyrinth_hw.safety import Goal, State
from labyrinth_hw.settings import load_hardware
from labyrinth_hw.vision import Sight, Vision, lens_of
from labyrinth_msgs.msg import BallEvent, BallState

CALLBACKS, CONTROL = 9, 10  # real-time priorities
SUPERVISION = 0.05  # s between looks at what must disarm; signals are answered within it, too
UNKNOWN = "_NODE_NAME_UNKNOWN_"  # of a publisher whose node has not been discovered yet
BUILT_IN = ("use_sim_time", "start_type_description_service", "qos_overrides.")
SUCCESS, FAILURE = TransitionCallbackReturn.SUCCESS, TransitionCallbackReturn.FAILURE


class HwNode(LifecycleNode):
    """Drives the servos in a thread of its own, one control period after the other, and publishes measurements.

    That thread, and every timer, follows the machine's steady clock; ROS's clock is used only for stamps.
    """

    def __init__(self) -> None:
        super().__init__("hw_node")
        config = self._declare("config", "paper", "name or path of a config/hw/*.yaml [-]")
        side = str(self._declare("side", "real", "prefix of the topics, within the node's namespace [-]")).rstrip("/")
        rate = self._declare("rate", 100.0, "control periods per second [Hz]", 10.0, 500.0)
        timeout = self._declare(
            "command_timeout", 0.2, "age at which a motor's command is old [s]", 0.02, 5.0, changes=True
        )
        patience = self._declare("connect_timeout", 5.0, "how long to wait for ports and servos [s]", 0.0, 600.0)
        self._autostart = self._declare(
            "autostart", True, "configure at start; otherwise a lifecycle manager does it [-]"
        )
        self._arm_at_start = self._declare("arm", False, "activate at start, so that commands are executed [-]")
        silence = self._declare(
            "disarm_after", 60.0, "silence after which the node deactivates itself; 0: never [s]", 0.0, 86400.0,
            changes=True,
        )  # fmt: skip
        dry_run = self._declare("dry_run", False, "read everything but move nothing [-]")
        position_error = self._declare(
            "compensate_position_error", False, "correct goals by the calibrated error map [-]"
        )
        slack = self._declare("compensate_slack", False, "correct goals by the calibrated slack of the belt [-]")
        self._refuse_unknown_parameters()
        self._settings = load_hardware(str(config))
        self._timeout, self._patience = float(timeout), float(patience)
        self._period = 1.0 / float(rate)
        self._dry_run = bool(dry_run)
        self.hardware = Hardware(
            self._settings, period=self._period, timeout=self._timeout, disarm_after=float(silence) or None,
            dry_run=self._dry_run, position_error=bool(position_error), slack=bool(slack),
        )  # fmt: skip
        self.refusal = ""  # why the last transition was refused
        self.exit_code = 0
        self._configured = self._active = False
        self._lock = threading.Lock()
        self._goals: dict[str, Goal] = {}
        self._requests: list[str] = []
        self._counts = {"cycles": 0, "late": 0, "silent": 0, "unseen": 0, "refused": 0}
        self._stamps, self._eye_stamps = (Stamps(lambda: int(self.get_clock().now().nanoseconds)) for _ in range(2))
        self._piezo: int | None = None
        self._place: tuple[float, float] | None = None
        self._logged = State.DISARMED
        self._stop = threading.Event()
        self._threads: list[threading.Thread] = []
        self._vision: Vision | None = None
        self._sight: Sight | None = None
        self._states = self.create_publisher(JointState, f"{side}/joint_states", **_qos())
        self._events = self.create_publisher(BallEvent, f"{side}/ball_event", **_qos())
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        if self._settings.camera is not None:
            self._balls = self.create_publisher(BallState, f"{side}/ball", **_qos())
            self._pictures = self.create_publisher(Image, f"{side}/camera/annotated", 1)
            self._raw = self.create_publisher(Image, f"{side}/camera/image_raw", 1)
            self._lens = self.create_publisher(CameraInfo, f"{side}/camera/camera_info", 1)
            tilt = self._settings.camera.tilt
            self._tilts = self.create_publisher(JointState, f"{side}/board_states", **_qos()) if tilt else None
        self._commands = self.create_subscription(JointState, f"{side}/joint_commands", self._commanded, **_qos())
        self.create_service(SetBool, f"{side}/arm", self._arm)
        self.create_service(Trigger, f"{side}/reset", self._reset)
        self.create_service(Trigger, f"{side}/supply_ball", self._supply)
        self.add_on_set_parameters_callback(self._may_change)
        self.add_post_set_parameters_callback(self._changed)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(1.0, self._report, clock=steady)
        self.create_timer(SUPERVISION, self._supervise, clock=steady)

    def start(self) -> None:
        """Configure and arm as the parameters say. Raises HardwareError where the rig cannot be configured."""
        if self._autostart and self.trigger_configure() != SUCCESS:
            raise HardwareError(self.refusal)
        if self._autostart and self._arm_at_start:
            self.trigger_activate()

    # -- transitions --------------------------------------------------------------------------------------------------

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Open the ports, measure and publish."""
        try:
            deadline = time.monotonic() + self._patience
            self._await_ports(deadline)
            self.hardware.connect(lambda error: self._awaits_servos(error, deadline))
            camera = self._settings.camera
            self._vision = Vision(camera) if camera is not None else None
        except (HardwareError, InputError, OSError) as error:
            self.hardware.close()
            return self._refused(f"Not configured: {error}")
        motors = ", ".join(f"{m.name} ({m.model.name}, id {m.id})" for m in self._settings.motors)
        self.get_logger().info(
            f"{motors} on {self._settings.servo_port}, {self._settings.baud} baud: "
            f"{self.hardware.bus.cycle * 1e3:.1f} ms of bus time in a period of {self._period * 1e3:g} ms."
            f"{' Dry run: nothing will move.' if self._dry_run else ''}"
        )
        self._stop.clear()
        self._threads = [threading.Thread(target=self._control, name="control", daemon=True)]
        if self._vision is not None:
            self._threads.append(threading.Thread(target=self._watch, name="vision", daemon=True))
        for thread in self._threads:
            thread.start()
        self._configured = True
        return SUCCESS

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Arm: commands that arrive from now on are executed."""
        if (complaint := self._too_many_publishers()) is not None:
            return self._refused(f"Not armed: {complaint}")
        try:
            self.hardware.arm()
        except (HardwareError, InputError) as error:
            return self._refused(f"Not armed: {error}")
        self._active = True
        return SUCCESS

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Disarm: torque goes off."""
        self.hardware.disarm()
        self._active = False
        with self._lock:
            self._goals.clear()
        return SUCCESS

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Torque off, ports closed."""
        self.close()
        return SUCCESS

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Torque off, ports closed, for good."""
        self.close()
        return SUCCESS

    def close(self) -> None:
        """Torque off, ports closed, in whatever state the node is."""
        self._stop.set()
        if self._vision is not None:
            self._vision.close()
        for thread in self._threads:
            thread.join(timeout=1.5)
        self._threads, self._vision, self._sight = [], None, None
        self._configured = self._active = False

    def _refused(self, reason: str) -> TransitionCallbackReturn:
        self.refusal = reason
        self.get_logger().error(reason)
        return FAILURE

    def _await_ports(self, deadline: float) -> None:
        """Wait until the ports' files exist: adapters and the emulated testbed may start after this node."""
        ports = [port for port in (self._settings.servo_port, self._settings.sensor_port) if port]
        while not all(map(os.path.exists, ports)) and time.monotonic() < deadline and rclpy.ok():
            time.sleep(0.05)

    def _awaits_servos(self, error: BusError, deadline: float) -> bool:
        """Whether to look for the servos again: they may get their power later, or a busy machine's testbed be late."""
        left = deadline - time.monotonic()
        if left > 0:
            self.get_logger().warning(f"Waits {left:.0f} s more. {error}", throttle_duration_sec=10.0)
        return left > 0 and bool(rclpy.ok())

    def _too_many_publishers(self) -> str | None:
        """What is wrong where more than one node may send commands; None where nothing is."""
        topic = self._commands.topic_name
        if self.count_publishers(topic) < 2:
            return None
        ends = self.get_publishers_info_by_topic(topic)
        names = [f"{end.node_namespace.rstrip('/')}/{end.node_name}" for end in ends if end.node_name != UNKNOWN]
        senders = sorted(names) + ["not known yet"] * (len(ends) - len(names))
        return f"{topic} has {len(senders)} publishers ({', '.join(senders)}); expected one. Stop the others, then arm."

    def _supervise(self) -> None:
        """Deactivate where the rig disarmed itself, stopped, or has two masters."""
        if not self._active:
            return
        if (complaint := self._too_many_publishers()) is not None:
            self.hardware.disarm(complaint)
        if not self.hardware.safety.armed:
            reasons = "; ".join(self.hardware.safety.reasons)
            self.trigger_deactivate()
            self.get_logger().warning(f"Disarmed: {reasons}.")

    # -- what comes in ------------------------------------------------------------------------------------------------

    def _declare(
        self, name: str, default: Any, text: str, low: float | None = None, high: float | None = None,
        changes: bool = False,
    ) -> Any:  # fmt: skip
        descriptor = ParameterDescriptor(description=text, read_only=not changes)
        if low is not None and high is not None:
            descriptor.floating_point_range = [FloatingPointRange(from_value=low, to_value=high, step=0.0)]
        return self.declare_parameter(name, default, descriptor).value

    def _refuse_unknown_parameters(self) -> None:
        unknown = [n for n in self._parameter_overrides if not self.has_parameter(n) and not n.startswith(BUILT_IN)]
        if unknown:
            valid = sorted(n for n in self._parameters if not n.startswith(BUILT_IN))
            near = [f" Did you mean '{n}'?" for name in unknown for n in get_close_matches(name, valid, 1)]
            raise InputError(
                f"Unknown parameters {', '.join(map(repr, unknown))}.{''.join(near)} Available: {', '.join(valid)}."
            )

    def _may_change(self, parameters: list[Parameter]) -> SetParametersResult:
        """Nothing that the rig's safety hangs on changes while it is armed."""
        names = [parameter.name for parameter in parameters if parameter.name in ("command_timeout", "disarm_after")]
        if names and self._active:
            reason = f"The rig is armed; {', '.join(names)} can change while it is disarmed. Disarm it first."
            return SetParametersResult(successful=False, reason=reason)
        return SetParametersResult(successful=True)

    def _changed(self, parameters: list[Parameter]) -> None:
        for parameter in parameters:
            if parameter.name == "command_timeout":
                self._timeout = self.hardware.safety.timeout = float(parameter.value)
            elif parameter.name == "disarm_after":
                self.hardware.safety.disarm_after = float(parameter.value) or None

    def _commanded(self, message: JointState) -> None:
        goals = dict(zip(message.name, message.position, strict=False))
        stamp = message.header.stamp.sec + message.header.stamp.nanosec * 1e-9
        age = self.get_clock().now().nanoseconds * 1e-9 - stamp if stamp else 0.0
        try:
            if not self._active:
                raise InputError(
                    f"The rig is disarmed. To arm it, activate {self.get_name()} or call {self._arm_name}."
                )
            if len(message.name) != len(message.position):
                raise InputError(f"{len(message.name)} names but {len(message.position)} positions.")
            if age > self._timeout:
                raise InputError(f"Its stamp is {age:.3f} s old; more than {self._timeout:g} s is too late.")
            if age < -self._timeout:
                raise InputError(
                    f"Its stamp is {-age:.3f} s ahead of this node's clock; expected {self._timeout:g} s at most. "
                    "Do both have the same time, and the same use_sim_time?"
                )
            self.hardware.safety.check(goals)
        except InputError as error:
            self._counts["refused"] += 1
            self.get_logger().warning(f"Refused a command: {error}", throttle_duration_sec=1.0)
            return
        # Time spent on the way counts, where the sender's clock says so.
        received = time.monotonic() - max(0.0, age)
        with self._lock:
            self._goals.update({name: Goal(angle, received) for name, angle in goals.items()})

    @property
    def _arm_name(self) -> str:
        return self._commands.topic_name.removesuffix("joint_commands") + "arm"

    def _arm(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        """The lifecycle's transitions, with a reason where they are refused."""
        if request.data and not self._active:
            if not self._configured:
                response.success, response.message = False, f"Configure {self.get_name()} first."
                return response
            if self.trigger_activate() != SUCCESS:
                response.success, response.message = False, self.refusal
                return response
        elif not request.data and self._active:
            self.trigger_deactivate()
        response.success = True
        response.message = "Armed: the next command moves the rig." if request.data else "Disarmed: torque is off."
        return response

    def _reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success = self._configured
        response.message = "Torque stays off until the rig is armed again." if self._configured else "Not configured."
        if self._configured:
            with self._lock:
                self._requests.append("reset")
                self._goals.clear()
        return response

    def _supply(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success = self._configured and self.hardware.sensors_connected
        response.message = "The depot releases a ball." if response.success else "The sensor line is not connected."
        if response.success:
            with self._lock:
                self._requests.append("supply_ball")
        return response

    # -- the control thread -------------------------------------------------------------------------------------------

    def _control(self) -> None:
        if not ask_for_priority(CONTROL):
            self.get_logger().info("No real-time priority; on a busy machine control periods may come late.")
        due = time.monotonic()
        try:
            while not self._stop.is_set():
                self._do_requests()
                with self._lock:
                    goals = dict(self._goals)
                measured = self.hardware.cycle(goals)
                self._counts["cycles"] += 1
                if measured is None:
                    self._counts["silent"] += 1
                elif rclpy.ok():
                    self._publish(measured)
                self._log_state()
                due += self._period
                wait = due - time.monotonic()
                if wait > 0:
                    self._stop.wait(wait)
                elif wait < -self._period:
                    self._counts["late"] += 1
                    due = time.monotonic()
        except BaseException as error:
            # Publishing while ROS shuts down fails too; that is an orderly end.
            if not self._stop.is_set() and rclpy.ok():
                self.get_logger().fatal(
                    f"The control thread ended, torque goes off:\n{''.join(traceback.format_exception(error))}"
                )
                self.exit_code = 1
                rclpy.try_shutdown()
        finally:
            self.hardware.disarm()
            self.hardware.close()

    def _do_requests(self) -> None:
        with self._lock:
            requests, self._requests = self._requests, []
        for request in requests:
            try:
                if request == "reset":
                    self.get_logger().info(f"Reset: {self.hardware.reset()}.")
                else:
                    self.hardware.supply_ball()
                    self._event(BallEvent.SUPPLIED)
            except HardwareError as error:
                self.get_logger().error(f"{request}: {error}")

    def _publish(self, measured: Measurement) -> None:
        board = measured.board
        if self._settings.sensor_port is not None and not measured.whole:
            # A message without the board, or with where it was, would be taken for a measurement.
            self._counts["unseen"] += 1
        else:
            stamp = self._stamps.at(measured.stamp)
            self._states.publish(joint_state(measured, self._settings.potentiometers, stamp))
        if board is not None:
            if self._piezo is not None and board.piezo != self._piezo:
                self._event(BallEvent.LOST)
            self._piezo = board.piezo

    def _event(self, kind: int) -> None:
        hole = self._settings.nearest_hole(self._place) if kind == BallEvent.LOST else -1
        event = BallEvent(kind=kind, hole=hole)
        event.header.stamp, event.header.frame_id = self.get_clock().now().to_msg(), "board_origin"
        self._events.publish(event)

    def _log_state(self) -> None:
        state = self.hardware.safety.state
        if state is not self._logged:
            self._logged = state
            if state is State.STOPPED:
                self.get_logger().error(f"Torque is off until reset: {'; '.join(self.hardware.safety.reasons)}.")
            elif not self.hardware.connected:
                self.get_logger().error(f"The servos are out of reach: {self.hardware.trouble}")
            else:
                self.get_logger().info(state.value)

    # -- the camera's thread, and diagnostics -------------------------------------------------------------------------

    def _watch(self) -> None:
        vision, camera = self._vision, self._settings.camera
        lens = lens_of(camera) if camera is not None else None
        while vision is not None and not self._stop.is_set():
            sight = vision.next(0.2)
            if sight is None or not rclpy.ok():
                continue
            stamp = self._eye_stamps.at(sight.stamp)
            self._balls.publish(ball_state(sight, stamp))
            if self._tilts is not None and sight.tilt is not None:
                self._tilts.publish(board_state(sight.tilt, stamp))
            if sight.visible:
                self._place = (sight.x, sight.y)
            self._sight = sight
            if lens is not None:
                self._lens.publish(camera_info(lens, stamp))
            # Pictures are drawn, and cross from the other process, only while there is a subscriber.
            for picture, asked, publisher in (
                (sight.picture, vision.pictures, self._pictures),
                (sight.raw, vision.raw, self._raw),
            ):
                if picture is not None:
                    publisher.publish(image(picture, stamp))
                if (wanted := publisher.get_subscription_count() > 0) != asked.is_set():
                    (asked.set if wanted else asked.clear)()

    def _report(self) -> None:
        if not self._configured:
            return
        counts = {**self._counts, "clock steps": self._stamps.steps}
        health = hardware_health(self.hardware, counts, self._vision is not None, self._sight)
        now = self.get_clock().now().to_msg()
        name = f"{self.get_fully_qualified_name().strip('/')}: servos"
        self._diagnostics.publish(diagnostics(health, name, self._settings.servo_port, now))


def _qos() -> dict[str, Any]:
    """A new profile for one entity, because rclpy's parameters change it and must not affect others."""
    return {
        "qos_profile": QoSProfile(depth=50),
        "qos_overriding_options": QoSOverridingOptions.with_default_policies(),
    }


def main(args: Sequence[str] | None = None) -> None:
    """Run the node until it is interrupted; exit code 2 for bad parameters or hardware that does not answer."""

    def terminated(number: int, frame: FrameType | None) -> None:
        rclpy.try_shutdown()

    ask_for_priority(CALLBACKS, children=True)  # before DDS starts its threads
    about = "Drives the real rig's servos and publishes what it measures."
    start_ros("hw_node", about, sys.argv[1:] if args is None else args)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, terminated)
    try:
        node = HwNode()
        node.start()
    except Exception as error:  # parameters or hardware that ROS or we refuse
        interrupted = not rclpy.ok()
        if not interrupted:
            print(f"hw_node: {error}", file=sys.stderr)
        rclpy.try_shutdown()
        sys.exit(0 if interrupted else 2)
    try:
        spin(node)
    finally:
        node.close()
        node.destroy_node()
        rclpy.try_shutdown()
    sys.exit(node.exit_code)


if __name__ == "__main__":
    main()
