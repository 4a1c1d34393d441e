# SPDX-License-Identifier: Apache-2.0
"""The servo's firmware, its DC motor and its friction, seen at the output shaft. Arrays are (n, 2): runs by axes.

Friction: Karnopp 1985 (stick inside a band of speed, where friction equals what is applied); Canudas de Wit, Olsson,
Astrom and Lischinsky 1995 (LuGre's bristles).
"""

from types import SimpleNamespace

import numpy as np

from labyrinth_hw.testbed.quantities import Array


def clipped(value: Array, low: Array | float, high: Array | float) -> Array:
    """What `np.clip` gives, at a third of its time for arrays as small as these."""
    return np.minimum(np.maximum(value, low), high)


def both(value: Array) -> Array:
    """Sum over the two axes, (n, 1)."""
    return value[:, :1] + value[:, 1:]


def level(q: SimpleNamespace, speed: Array, load: Array, softening: Array) -> Array:
    """Sliding friction torque, N m, at this speed and transmitted torque, before its sign.

    Args:
        q: quantities.
        speed: rad/s.
        load: N m carried by the gear: what the motor drives against what the belt holds back.
        softening: share of friction left after warming, 1 when cold.
    """
    dry = q.coulomb + q.static * np.exp(-np.square(speed / q.stribeck_speed)) + q.load_friction * np.abs(load)
    return dry * softening * (1.0 + q.direction_friction * np.sign(speed))


def karnopp_step(speed: Array, torque: Array, inertia: Array, dry: Array, viscous: Array, dt: float) -> Array:
    """Speed after one step under dry friction that can hold but never push.

    The change of speed that friction may cause in a step is dry*dt/inertia; it brings the body to rest at most.
    """
    free = speed + dt * (torque - viscous * speed) / inertia
    return np.sign(free) * np.maximum(np.abs(free) - dt * dry / inertia, 0.0)


class LuGre:
    """Bristle deflection of the runs whose friction is LuGre's; the others are left alone."""

    def __init__(self, q: SimpleNamespace) -> None:
        self.active = q.bristle > 0
        self.any = bool(self.active.any())
        self.deflection = np.zeros_like(q.bristle)

    def torque(self, q: SimpleNamespace, speed: Array, dry: Array, dt: float) -> Array:
        """Friction torque against the motion, N m: s0 z + s1 dz/dt, dz/dt = v - s0 |v| z / g(v)."""
        # Integrated exactly for constant speed over the step, so that stiff bristles stay stable.
        g = np.maximum(dry, 1e-9)
        rate = q.bristle * np.abs(speed) / g
        before = self.deflection
        settled = g * np.sign(speed) / np.where(self.active, q.bristle, 1.0)
        after = settled + (before - settled) * np.exp(-rate * dt)
        self.deflection = np.where(self.active, after, 0.0)
        return np.where(self.active, q.bristle * after + q.bristle_damping * (after - before) / dt, 0.0)


def cogging(q: SimpleNamespace, angle: Array) -> Array:
    """Cogging torque, N m, at this servo angle (rad)."""
    return q.cogging * np.sin(q.cogging_count * angle + q.cogging_phase)


COPPER = 0.0039  # relative growth of resistance per kelvin
MAGNET = 0.0012  # relative loss of flux per kelvin
SAMPLE = 0.01  # s over which `d` counts the change of the error
WARM = 25.0  # degC at which the constants hold


def quantised(value: Array, tick: Array) -> Array:
    """The nearest multiple of `tick`; unchanged where the tick is 0."""
    return np.where(tick > 0, np.rint(value / np.where(tick > 0, tick, 1.0)) * tick, value)


def position_error(q: SimpleNamespace, angle: Array) -> Array:
    """Error of the servo's own position measurement, rad, at this true angle."""
    wave = q.error_amplitude * np.sin(q.error_count * angle + q.error_phase)
    return wave + q.error_slope * angle


class Firmware:
    """Turns goal and measured position into a duty cycle, once every control period."""

    def __init__(self, q: SimpleNamespace, start: Array, period: float) -> None:
        self.period = period
        self.duty = np.zeros_like(q.p)
        self.goal = start.copy()
        self.integral = np.zeros_like(q.p)
        self.error = np.zeros_like(q.p)
        self.as_duty = np.isclose(q.firmware, 1.0)
        self.by_law = np.isclose(q.firmware, 2.0)
        self.any_duty, self.any_law = bool(self.as_duty.any()), bool(self.by_law.any())
        self.asked = np.full_like(q.p, np.nan)  # N m, of servos in current mode whose computer is a real one
        self._held, self._due = np.zeros_like(q.p), np.zeros_like(q.p)
        self.limited = q.command_rate > 0
        self.any_limited = bool(self.limited.any())
        self.ticking = bool((q.control_tick > 0).any() or (q.command_tick > 0).any())

    def update(self, q: SimpleNamespace, goal: Array, measured: Array, speed: Array, supply: Array) -> None:
        """One control period.

        Args:
            goal, measured: rad, as the servo sees them.
            speed: rad/s of the shaft.
            supply: V at the terminals.
        """
        wanted = q.command_gain * goal
        if self.ticking:
            wanted, measured = quantised(wanted, q.command_tick), quantised(measured, q.control_tick)
        if self.any_limited:
            step = self.period * q.command_rate
            self.goal = np.where(self.limited, self.goal + clipped(wanted - self.goal, -step, step), wanted)
        else:
            self.goal = wanted
        raw = self.goal - measured
        error = raw - clipped(raw, -q.margin, q.margin)
        self.integral += self.period * error
        change, self.error = error - self.error, error
        velocity = q.p * error + q.i * self.integral + q.d * change * (SAMPLE / self.period)
        torque = q.velocity_gain * (velocity - speed)
        if self.any_law:
            self._due -= self.period
            again = self._due < 0.5 * self.period
            self._held = np.where(again, q.stiffness * error - q.law_damping * speed, self._held)
            self._due = np.where(again, q.law_period, self._due)
            torque = np.where(self.by_law, self._held, torque)
        torque = np.where(np.isfinite(self.asked), self.asked, torque)
        duty = (torque / q.kt * q.resistance + q.ke * speed) / supply
        if self.any_duty:
            duty = np.where(self.as_duty, q.duty_gain * error + q.punch * np.sign(error), duty)
        self.duty = clipped(duty, -q.duty_limit, q.duty_limit)


class DCMotor:
    """A brushed DC motor behind a gear: V = R i + ke w, with sagging supply and a warming winding."""

    def __init__(self, q: SimpleNamespace) -> None:
        self.current = np.zeros_like(q.p)
        self.temperature = np.full_like(q.p, WARM + 5.0)
        self.supply = q.supply.copy()
        self.resistance = q.resistance.copy()
        self.kt = q.kt.copy()

    def torque(self, q: SimpleNamespace, duty: Array, speed: Array) -> Array:
        """Electromagnetic torque at the shaft, N m, at the voltage to which the supply sags with these duties."""
        self._draw(q, duty, speed)
        self._sag(q, duty)
        self._draw(q, duty, speed)
        return self.kt * self.current

    def _draw(self, q: SimpleNamespace, duty: Array, speed: Array) -> None:
        current = (duty * self.supply - q.ke * speed) / self.resistance
        self.current = clipped(current, -q.current_limit, q.current_limit)

    def warm(self, q: SimpleNamespace, dt: float) -> None:
        """Let heat flow for `dt` seconds."""
        lost = self.resistance * np.square(self.current) - (self.temperature - WARM) / q.thermal_resistance
        self.temperature = self.temperature + dt * lost / q.heat_capacity
        above = self.temperature - WARM
        self.resistance = q.resistance * (1 + COPPER * above)
        self.kt = q.kt * (1 - MAGNET * above)

    def _sag(self, q: SimpleNamespace, duty: Array) -> None:
        """One Newton step to the voltage at which the supply gives what the motors' bridges draw; none flows back."""
        drawn = duty * self.current
        follows = np.where((drawn > 0) & (np.abs(self.current) < q.current_limit), duty**2 / self.resistance, 0.0)
        off = self.supply - q.supply + q.supply_resistance * both(np.maximum(drawn, 0.0))
        slope = 1.0 + q.supply_resistance * both(follows)
        self.supply = clipped(self.supply - off / slope, 1.0, q.supply)
