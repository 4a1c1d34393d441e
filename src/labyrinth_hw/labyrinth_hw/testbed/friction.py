# SPDX-License-Identifier: Apache-2.0
"""Friction: Karnopp's switching law, LuGre's bristles, and cogging.

Karnopp 1985 (stick inside a band of speed, where friction equals what is applied); Canudas de Wit, Olsson, Astrom and
Lischinsky 1995 (LuGre). Arrays are (n, 2): rows are runs, columns the axes.
"""

from types import SimpleNamespace

import numpy as np

from labyrinth_hw.testbed.parameters import Array

TURN = 2 * np.pi


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
