# SPDX-License-Identifier: Apache-2.0
"""The true form of what lies outside the library, as an effect with its numbers left open.

Fitted to what was recorded it says how much of the error on another command the best law could have taken away; its
base values were fitted to the same recordings, and need not hold there either. Signs and shapes are those of physics.c.
"""

import math

import numpy as np

from drawn_rigs.reading import Array, Effect, Parameter, Site, Values, filters, law, other_angle, state

NEAR = 1.02  # times the true period, at most


@law
def _cogging(raw: int) -> None:
    s = state(raw)
    s.applied[s.dof] += s.values[0] * math.sin(2.0 * math.pi * s.qpos[s.angle] / s.values[1])


@law
def _drag(raw: int) -> None:
    s = state(raw)
    s.damping[s.dof] += s.values[0] * abs(s.qvel[s.dof])


@law
def _tight(raw: int) -> None:
    s = state(raw)
    s.frictionloss[s.dof] += s.values[0] * max(math.sin(2.0 * math.pi * s.qpos[s.angle] / s.values[1]), 0.0)


@law
def _other_friction(raw: int) -> None:
    s = state(raw)
    s.frictionloss[s.dof] += s.values[0] * abs(other_angle(s))


def _ripple(values: Values, site: Site, step: float, start: Array) -> filters.Map:
    size, period = values["size"][:, None], values["period"][:, None]
    return filters.Map(lambda angle: angle + size * np.sin(2.0 * np.pi * angle / period))


UNITS = {"cogging": "N m", "quadratic_drag": "N m s^2/rad^2", "tight_places": "N m", "other_axis_friction": "N m/rad",
         "eccentric_gear": "rad"}  # fmt: skip
STEPS = {"cogging": _cogging, "quadratic_drag": _drag, "tight_places": _tight, "other_axis_friction": _other_friction}
TOUCHES = {"quadratic_drag": ("dof_damping",), "tight_places": ("dof_frictionloss",),
           "other_axis_friction": ("dof_frictionloss",)}  # fmt: skip


def true_form(effect: str, period: float) -> Effect | None:
    """The effect that a form outside the library is; None where none has this form.

    Args:
        effect: its name in `effects.FORMS`.
        period: rad, the true one, of what goes by waves.
    """
    if effect not in UNITS:
        return None
    of_sensor = effect == "eccentric_gear"
    most = 0.2 if of_sensor else 10.0
    parameters = [Parameter("size", UNITS[effect], -most if of_sensor else 0.0, most, 0.0, 0.1 * most**0.5, "any")]
    if period:
        parameters.append(
            Parameter("period", "rad", period / NEAR, period * NEAR, None, period, "the true one, nearly")
        )
    return Effect(
        name=f"true_{effect}", title=effect, physics="What the rig has.", equation="as in physics.c",
        parameters=tuple(parameters), stage="measurement" if of_sensor else "force", mark="", shows="by_angle",
        confused_with=(), separated_by="", where="signal" if of_sensor else "axis",
        needs=("other_axis",) if effect == "other_axis_friction" else (), couples=effect == "other_axis_friction",
        touches=TOUCHES.get(effect, ()), step=STEPS.get(effect), measure=_ripple if of_sensor else None,
    )  # fmt: skip
