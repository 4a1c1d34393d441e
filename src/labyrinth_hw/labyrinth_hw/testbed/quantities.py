# SPDX-License-Identifier: Apache-2.0
"""Every physical quantity of the emulated rig, its unit, and its value on a healthy one."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labyrinth_hw.errors import InputError, unknown_name

Array = NDArray[np.float64]
AXES = ("x", "y")


@dataclass(frozen=True)
class Quantity:
    """One physical quantity: value on the healthy rig for x and y, unit, meaning."""

    x: float
    y: float
    unit: str
    text: str


def _both(value: float, unit: str, text: str) -> Quantity:
    return Quantity(value, value, unit, text)


QUANTITIES: dict[str, Quantity] = {
    # command on its way to the servo
    "command_delay": _both(0.020, "s", "from the packet to the servo's controller"),
    "command_jitter": _both(0.0, "s", "standard deviation of that delay, a new value for each command"),
    "command_loss": _both(0.0, "1", "share of commands that never arrive"),
    "command_tick": _both(0.0, "rad", "resolution of the goal position; 0 is continuous"),
    "command_gain": _both(1.0, "1", "goal reached over goal sent"),
    "command_rate": _both(0.0, "rad/s", "largest speed of the goal inside the servo; 0 is unlimited"),
    # firmware
    "firmware": _both(0.0, "1", "0: velocity loop following P*error; 1: duty cycle = gain*error; 2: current by a law"),
    "p": _both(20.0, "1/s", "commanded speed over position error"),
    "i": _both(0.0, "1/s^2", "commanded speed over integrated error"),
    "d": _both(0.0, "1/s", "commanded speed over the error's change in 10 ms"),
    "velocity_gain": _both(2.0, "N m s/rad", "torque over speed error of the velocity loop"),
    "duty_gain": _both(8.0, "1/rad", "duty over position error of the duty firmware"),
    "stiffness": _both(0.25, "N m/rad", "torque over position error of the law on the current"),
    "law_damping": _both(0.012, "N m s/rad", "torque over speed of that law"),
    "law_period": _both(0.005, "s", "between two currents that the computer sends under that law"),
    "punch": _both(0.0, "1", "duty added as soon as the error leaves the margin"),
    "margin": _both(0.0, "rad", "compliance margin: errors below it are ignored"),
    "control_tick": _both(0.0, "rad", "resolution of the servo's own position measurement; 0 is continuous"),
    "duty_limit": _both(1.0, "1", "largest duty"),
    # motor, seen at the output shaft
    "supply": _both(12.0, "V", "open-circuit voltage of the supply"),
    "supply_resistance": _both(0.02, "ohm", "resistance of the supply that both servos share"),
    "resistance": _both(2.9, "ohm", "winding at 25 degC"),
    "ke": _both(1.75, "V s/rad", "back-EMF constant times gear ratio"),
    "kt": _both(1.46, "N m/A", "torque constant times gear ratio and efficiency"),
    "current_limit": _both(4.1, "A", "of the driver"),
    "rotor_inertia": _both(1.0e-2, "kg m^2", "rotor and gear"),
    "thermal_resistance": _both(6.0, "K/W", "winding to surroundings"),
    "heat_capacity": _both(25.0, "J/K", "of the winding"),
    "thermal_friction": _both(0.0, "1/K", "relative loss of gear friction per kelvin of warming"),
    "thermal_warmup": _both(0.0, "K", "steady warming by the surroundings, reached with the time constant below"),
    "thermal_time": _both(60.0, "s", "time constant of that warming"),
    "thermal_bias": _both(0.0, "rad/K", "drift of the position measurement with warming"),
    # dry and wet friction at the servo's output
    "coulomb": _both(0.0, "N m", "sliding friction"),
    "idle_friction": _both(0.2, "N m", "more sliding friction while torque is off: the gear hardly turns backwards"),
    "static": _both(0.0, "N m", "breakaway friction above the sliding one"),
    "stribeck_speed": _both(0.05, "rad/s", "speed at which the extra breakaway friction has gone to 1/e"),
    "viscous": _both(0.02, "N m s/rad", "proportional to speed"),
    "load_friction": _both(0.0, "1", "friction over the torque that the gear carries"),
    "direction_friction": _both(0.0, "1", "relative difference of friction, moving up over moving down"),
    "bristle": _both(0.0, "N m/rad", "stiffness of LuGre's bristles; 0 is Karnopp friction"),
    "bristle_damping": _both(0.0, "N m s/rad", "of the bristles"),
    "cogging": _both(0.0, "N m", "amplitude of the cogging torque"),
    "cogging_count": _both(48.0, "1/turn", "periods of the cogging torque in a turn"),
    "cogging_phase": _both(0.0, "rad", "of the cogging torque"),
    "torque_noise": _both(0.004, "N m", "standard deviation of a random torque on the board, a new value every 10 ms"),
    # belt between servo and board
    "ratio": _both(1.0, "1", "board angle over servo angle"),
    "belt_stiffness": _both(100.0, "N m/rad", "of the belt, at the board"),
    "belt_damping": _both(0.3, "N m s/rad", "of the belt"),
    "belt_hysteresis": _both(0.0, "N m", "torque of the belt's inner friction"),
    "belt_hysteresis_stiffness": _both(30.0, "N m/rad", "with which that friction builds up"),
    "play": _both(0.0, "rad", "total slack between servo and board"),
    "mount_play": _both(0.0, "rad", "total travel of a loose servo mount"),
    "mount_friction": _both(0.05, "N m", "belt torque at which the loose mount slips"),
    "cross_axis": _both(0.0, "1", "turn of this board axis per turn of the other one, by bent couplings"),
    # board
    "board_inertia": Quantity(3.4e-3, 2.1e-3, "kg m^2", "about this axis"),
    "board_friction": _both(0.0, "N m", "sliding friction of the gimbal"),
    "board_viscous": _both(0.002, "N m s/rad", "of the gimbal"),
    "gravity_moment": _both(0.0, "N m", "weight times horizontal distance of the centre of mass from the axis"),
    "gravity_height": _both(0.0, "N m/rad", "weight times height of the centre of mass above the axis"),
    "return_spring": _both(0.0, "N m/rad", "pulling the board level"),
    "stop_angle": _both(0.14, "rad", "mechanical end of travel, both ways"),
    "stop_stiffness": _both(120.0, "N m/rad", "of the end stops"),
    # positioning error of the servo's own measurement: A sin(2 pi n angle / turn + phase)
    "error_amplitude": _both(0.0, "rad", "amplitude of the local positioning error"),
    "error_count": _both(40.0, "1/turn", "periods of the local positioning error in a turn"),
    "error_phase": _both(0.0, "rad", "of the local positioning error"),
    "error_slope": _both(0.0, "1", "local positioning error proportional to the angle"),
    "error_reported": _both(0.0, "1", "share of that error that the reported encoder angle holds too"),
    # what is measured: encoder of the servo, potentiometer of the board
    "encoder_tick": _both(0.0015339807878856412, "rad", "resolution of the encoder as reported"),
    "encoder_bias": _both(0.0, "rad", "added to the encoder"),
    "encoder_gain": _both(1.0, "1", "of the encoder"),
    "encoder_delay": _both(0.0, "s", "age of the encoder's value beyond its stamp"),
    "encoder_lag": _both(0.0, "s", "time constant of the encoder's filter"),
    "encoder_noise": _both(6.0e-4, "rad", "standard deviation, before rounding to ticks"),
    "pot_tick": _both(1.0e-4, "rad", "resolution of the potentiometer's converter"),
    "pot_bias": _both(0.0, "rad", "added to the potentiometer"),
    "pot_gain": _both(1.0, "1", "of the potentiometer"),
    "pot_delay": _both(0.0, "s", "age of the potentiometer's value beyond its stamp"),
    "pot_lag": _both(0.0, "s", "time constant of the potentiometer's filter"),
    "pot_noise": _both(3.0e-4, "rad", "standard deviation"),
    # ball (x: rolling along the board's x axis) and camera
    "rolling_friction": _both(0.002, "1", "rolling resistance over weight"),
    "restitution": _both(0.5, "1", "speed after over speed before a wall"),
    "not_level": _both(0.0, "rad", "tilt of the whole rig, seen by the ball, not by the potentiometers"),
    "camera_latency": _both(0.0, "s", "exposure to stamp"),
    "camera_scale": _both(1.0, "1", "measured over true distance from the board's centre"),
    "camera_noise": _both(4.0e-4, "m", "standard deviation"),
}  # fmt: skip


@dataclass(frozen=True)
class Reality:
    """One rig: a value of every quantity for both axes, by name."""

    values: Mapping[str, tuple[float, float]]

    def with_values(self, changes: Mapping[str, Any]) -> "Reality":
        """A changed rig.

        Args:
            changes: quantity -> number for both axes, or {x: number, y: number}.

        Raises:
            InputError: unknown names or values that are no numbers, all at once.
        """
        merged, complaints = dict(self.values), []
        for name, value in changes.items():
            if name not in QUANTITIES:
                complaints.append(unknown_name("quantity", name, QUANTITIES))
                continue
            both = value if isinstance(value, Mapping) else dict.fromkeys(AXES, value)
            for axis, number in both.items():
                if axis not in AXES or isinstance(number, bool) or not isinstance(number, (int, float)):
                    complaints.append(f"{name}: expected a number, or x: and y: with one each, got {value!r}.")
                    break
                pair = list(merged[name])
                pair[AXES.index(axis)] = float(number)
                merged[name] = (pair[0], pair[1])
        if complaints:
            raise InputError(complaints)
        return Reality(merged)


HEALTHY = Reality({name: (q.x, q.y) for name, q in QUANTITIES.items()})


def stack(realities: Sequence[Reality], repeats: int = 1) -> SimpleNamespace:
    """Quantities as arrays (n, 2): n = len(realities) * repeats rows, columns x and y.

    A quantity keeps its name as attribute. Rows of one reality follow each other.
    """
    rows = {
        name: np.repeat(np.array([reality.values[name] for reality in realities]), repeats, axis=0)
        for name in QUANTITIES
    }
    return SimpleNamespace(**rows)
