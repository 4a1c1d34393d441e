# SPDX-License-Identifier: Apache-2.0
"""Joints whose motion is prescribed: they move as they are told, whatever acts on them, and act on the others as they
do.

No drive that a model file may name: an analysis puts it in the place of a joint's own, to look at another joint alone.
"""

from collections.abc import Collection
from dataclasses import replace

import mujoco

from labyrinth_sim.effect import Drive, Values
from labyrinth_sim.live import Fields
from labyrinth_sim.model import DriveUse, Model
from labyrinth_sim.servo import limit_torque
from labyrinth_sim.site import Site
from labyrinth_sim.trials import Array

HEAVY = 1e6  # kg m^2 or kg, so much more than any load that no load moves it
RATE = 50.0  # rad/s, at which it closes in on its target, critically damped: slow beside MuJoCo's steps
STRONGEST = 1e12  # N m or N


def command(position: Array, speed: Array, acceleration: Array) -> Array:
    """The target under which a prescribed joint follows a motion, each (T,) in rad and s: `u = q + 2 q' / r + q'' /
    r^2`, the inverse of how it closes in on a target at the rate r.
    """
    return position + 2.0 / RATE * speed + acceleration / RATE**2


def with_prescribed(model: Model, axes: Collection[str]) -> Model:
    """The model with these axes prescribed; without their effects, which have nothing to act on."""
    drives = {name: DriveUse(DRIVE, {}) if name in axes else use for name, use in model.drives.items()}
    kept = tuple(use for use in model.effects if use.place not in axes)
    return replace(model, valid=None, drives=drives, effects=kept)


def prescribed(model: Model) -> tuple[str, ...]:
    """The axes of a model that are prescribed."""
    return tuple(name for name, use in model.drives.items() if use.kind is DRIVE)


def _spec(spec: mujoco.MjSpec, site: Site) -> None:
    servo = spec.actuator(site.the_axis.actuator)
    servo.set_to_position(kp=1.0, kv=1.0)
    limit_torque(servo)


def _fields(fields: Fields, site: Site, values: Values) -> None:
    fields["dof_armature"][:, site.dof] = HEAVY
    fields["dof_frictionloss"][:, site.dof] = 0.0
    fields["actuator_gainprm"][:, site.actuator, 0] = HEAVY * RATE**2
    fields["actuator_biasprm"][:, site.actuator, 1] = -HEAVY * RATE**2
    fields["actuator_biasprm"][:, site.actuator, 2] = -2.0 * HEAVY * RATE
    fields["actuator_forcerange"][:, site.actuator] = -STRONGEST, STRONGEST


DRIVE = Drive(
    name="prescribed",
    title="Prescribed motion",
    physics="The joint moves as it is told, whatever acts on it.",
    equation="q'' = r^2 (target - q) - 2 r q'",
    parameters=(),
    spec=_spec,
    fields=_fields,
)
