# SPDX-License-Identifier: Apache-2.0
"""What can be wrong with the emulated rig, and how badly: quantities for a weak, a medium and a strong case."""

from dataclasses import dataclass

STRENGTHS = ("weak", "medium", "strong")


@dataclass(frozen=True)
class HiddenEffect:
    """One thing that can be wrong.

    Attributes:
        text: one sentence of physics.
        quantities: quantity -> its values at weak, medium and strong.
        known: whether the effect library of the simulation has a counterpart of this name.
        ball: acts on the ball or the camera rather than on an axis's servo and board.
        signed: the sign of the first quantity is drawn too (around 1 for a factor).
        factor: the values are relative deviations from the healthy value, not the value itself.
    """

    text: str
    quantities: dict[str, tuple[float, float, float]]
    known: bool = True
    ball: bool = False
    signed: bool = False
    factor: bool = False


EFFECTS: dict[str, HiddenEffect] = {
    "command_delay": HiddenEffect("Commands reach the servo late.", {"command_delay": (0.028, 0.038, 0.055)}),
    "command_quantisation": HiddenEffect("Goals are rounded to coarse steps.", {"command_tick": (0.004, 0.008, 0.016)}),
    "dead_band": HiddenEffect("Errors below a margin are ignored.", {"margin": (0.003, 0.006, 0.012)}),
    "rate_limit": HiddenEffect("The goal moves at a limited speed.", {"command_rate": (1.2, 0.6, 0.3)}),
    "saturation": HiddenEffect("The duty cycle is limited.", {"duty_limit": (0.16, 0.09, 0.05)}),
    "supply_sag": HiddenEffect(
        "The supply yields under load.", {"supply_resistance": (6.0, 15.0, 40.0), "duty_limit": (0.16, 0.16, 0.16)}
    ),
    "backlash": HiddenEffect("Play between servo and board.", {"play": (0.003, 0.008, 0.02)}),
    "belt_compliance": HiddenEffect(
        "The belt gives way.", {"belt_stiffness": (4.0, 1.5, 0.6), "belt_damping": (0.05, 0.03, 0.02)}
    ),
    "coulomb": HiddenEffect("Dry friction in the servo.", {"coulomb": (0.08, 0.2, 0.5)}),
    "viscous": HiddenEffect("Friction proportional to speed.", {"viscous": (0.15, 0.5, 1.5)}),
    "stribeck": HiddenEffect(
        "Breaking away takes more than sliding.",
        {"static": (0.1, 0.25, 0.6), "coulomb": (0.05, 0.1, 0.2), "stribeck_speed": (0.1, 0.1, 0.1)},
    ),
    "load_friction": HiddenEffect(
        "Friction grows with the transmitted torque.", {"load_friction": (0.2, 0.5, 1.0), "return_spring": (2.0, 3.0, 4.0)}
    ),
    "directional_friction": HiddenEffect(
        "Friction differs between up and down.", {"direction_friction": (0.3, 0.5, 0.8), "coulomb": (0.15, 0.25, 0.5)}
    ),
    "gravity_load": HiddenEffect("The board is unbalanced.", {"gravity_moment": (0.05, 0.15, 0.4)}, signed=True),
    "return_spring": HiddenEffect("A spring pulls the board level.", {"return_spring": (1.0, 3.0, 8.0)}),
    "cross_axis": HiddenEffect("One servo turns the other axis too.", {"cross_axis": (0.02, 0.06, 0.15)}, signed=True),
    "position_error": HiddenEffect(
        "The servo measures its own angle wrongly, by angle.", {"error_amplitude": (0.002, 0.005, 0.012)}
    ),
    "gain_error": HiddenEffect("The angle reached is a share of the goal.", {"command_gain": (0.03, 0.07, 0.15)}, signed=True, factor=True),
    "sensor_bias": HiddenEffect(
        "The encoder is off by a constant.", {"encoder_bias": (0.002, 0.006, 0.015)}, signed=True
    ),
    "sensor_gain": HiddenEffect("The encoder's scale is wrong.", {"encoder_gain": (0.03, 0.07, 0.15)}, signed=True, factor=True),
    "sensor_delay": HiddenEffect("The encoder's values are old.", {"encoder_delay": (0.006, 0.015, 0.04)}),
    "sensor_lag": HiddenEffect("The encoder is filtered.", {"encoder_lag": (0.008, 0.02, 0.05)}),
    "sensor_quantisation": HiddenEffect("The encoder is coarse.", {"encoder_tick": (0.004, 0.008, 0.016)}),
    "rolling_friction": HiddenEffect("The ball rolls stiffly.", {"rolling_friction": (0.006, 0.012, 0.03)}, ball=True),
    "restitution": HiddenEffect("Walls swallow the ball's speed.", {"restitution": (0.35, 0.2, 0.05)}, ball=True),
    "not_level": HiddenEffect("The rig stands askew.", {"not_level": (0.003, 0.008, 0.02)}, ball=True, signed=True),
    "camera_latency": HiddenEffect("The ball's position is old.", {"camera_latency": (0.02, 0.05, 0.12)}, ball=True),
    "camera_scale": HiddenEffect("The camera's scale is wrong.", {"camera_scale": (0.02, 0.05, 0.1)}, ball=True, signed=True, factor=True),
    # Outside the library: a diagnosis should say "unknown".
    "cogging": HiddenEffect("The motor's magnets hold it at some angles.", {"cogging": (0.08, 0.2, 0.45)}, known=False),
    "thermal_drift": HiddenEffect(
        "Warming changes friction and the angle measured, over the whole session.",
        {"thermal_warmup": (10.0, 20.0, 30.0), "thermal_bias": (2e-4, 5e-4, 1e-3), "thermal_friction": (0.01, 0.02, 0.025),
         "coulomb": (0.1, 0.15, 0.25)},
        known=False,
    ),
    "lugre_presliding": HiddenEffect(
        "Friction yields like a spring before it slides.",
        {"bristle": (15.0, 12.0, 10.0), "bristle_damping": (0.05, 0.05, 0.05), "coulomb": (0.15, 0.3, 0.6),
         "static": (0.05, 0.1, 0.2)},
        known=False,
    ),
    "belt_hysteresis": HiddenEffect(
        "The belt remembers how it was stretched.",
        {"belt_hysteresis": (0.01, 0.02, 0.03), "belt_stiffness": (5.0, 3.0, 2.0), "return_spring": (0.5, 0.8, 1.0)},
        known=False,
    ),
    "loose_mount": HiddenEffect(
        "The servo slips in its mount.", {"mount_play": (0.006, 0.015, 0.03), "mount_friction": (0.04, 0.04, 0.04),
                                        "return_spring": (2.0, 2.0, 2.0)}, known=False,
    ),
    "irregular_commands": HiddenEffect(
        "Commands come at uneven times, and some not at all.",
        {"command_jitter": (0.006, 0.015, 0.03), "command_loss": (0.05, 0.1, 0.2)},
        known=False,
    ),
}  # fmt: skip
