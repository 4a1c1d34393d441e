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
        sensor: acts on one sensor, the encoder ("motor_x") or the potentiometer ("board_x").
        signed: the sign of the first quantity is drawn too (around 1 for a factor).
        factor: the values are relative deviations from the healthy value, not the value itself.
    """

    text: str
    quantities: dict[str, tuple[float, float, float]]
    known: bool = True
    ball: bool = False
    sensor: bool = False
    signed: bool = False
    factor: bool = False


EFFECTS: dict[str, HiddenEffect] = {
    "command_delay": HiddenEffect("Commands reach the servo late.", {"command_delay": (0.070, 0.085, 0.120)}),
    "command_quantisation": HiddenEffect("Goals are rounded to coarse steps.", {"command_tick": (0.004, 0.008, 0.016)}),
    "dead_band": HiddenEffect("Errors below a margin are ignored.", {"margin": (0.001, 0.004, 0.010)}),
    "rate_limit": HiddenEffect("The goal moves at a limited speed.", {"command_rate": (1.5, 0.7, 0.3)}),
    "torque_saturation": HiddenEffect("The driver limits the current.", {"current_limit": (0.50, 0.20, 0.08)}),
    "supply_sag": HiddenEffect("The supply yields under load.", {"supply_resistance": (10.0, 15.0, 40.0)}),
    "backlash": HiddenEffect("Play between servo and board.", {"play": (0.0025, 0.006, 0.018)}),
    "belt_compliance": HiddenEffect("The belt gives way.", {"belt_stiffness": (15.0, 6.0, 2.0)}),
    "coulomb_friction": HiddenEffect("Dry friction in the servo.", {"coulomb": (0.03, 0.12, 0.35)}),
    "viscous_friction": HiddenEffect("Friction proportional to speed.", {"viscous": (0.6, 1.0, 2.0)}),
    "stribeck_friction": HiddenEffect(
        "Breaking away takes more than sliding.", {"static": (0.05, 0.15, 0.4), "stribeck_speed": (0.1, 0.1, 0.1)}
    ),
    "load_friction": HiddenEffect(
        "Friction grows with the torque that the gear carries.", {"load_friction": (0.3, 0.37, 0.45)}
    ),
    "direction_friction": HiddenEffect(
        "Friction acts in one direction only.",
        {"direction_friction": (1.0, 1.0, 1.0), "coulomb": (0.02, 0.07, 0.2)},
        signed=True,
    ),
    "gravity_load": HiddenEffect("The board is unbalanced.", {"gravity_moment": (0.03, 0.12, 0.35)}, signed=True),
    "return_spring": HiddenEffect("A spring pulls the board level.", {"return_spring": (0.8, 3.0, 8.0)}),
    "cross_coupling": HiddenEffect(
        "One board axis turns the other too.", {"cross_axis": (0.015, 0.05, 0.15)}, signed=True
    ),
    "positioning_error": HiddenEffect(
        "The servo measures its own angle wrongly, by angle.", {"error_amplitude": (0.001, 0.004, 0.010)}
    ),
    "gain_error": HiddenEffect(
        "The angle reached is a multiple of the goal.", {"command_gain": (0.02, 0.06, 0.15)}, signed=True, factor=True
    ),
    "sensor_bias": HiddenEffect(
        "A sensor is off by a constant.", {"encoder_bias": (0.0015, 0.006, 0.015)}, sensor=True, signed=True
    ),
    "sensor_gain": HiddenEffect(
        "A sensor's scale is wrong.", {"encoder_gain": (0.03, 0.06, 0.15)}, sensor=True, signed=True, factor=True
    ),
    "sensor_delay": HiddenEffect("A sensor's values are old.", {"encoder_delay": (0.007, 0.015, 0.040)}, sensor=True),
    "sensor_lag": HiddenEffect("A sensor is filtered.", {"encoder_lag": (0.008, 0.020, 0.050)}, sensor=True),
    "sensor_quantisation": HiddenEffect("A sensor is coarse.", {"encoder_tick": (0.007, 0.010, 0.016)}, sensor=True),
    "rolling_friction": HiddenEffect("The ball rolls stiffly.", {"rolling_friction": (0.006, 0.012, 0.03)}, ball=True),
    "restitution": HiddenEffect("Walls swallow the ball's speed.", {"restitution": (0.35, 0.2, 0.05)}, ball=True),
    "board_not_level": HiddenEffect(
        "The rig stands askew.", {"not_level": (0.003, 0.008, 0.02)}, ball=True, signed=True
    ),
    "camera_latency": HiddenEffect("The ball's position is old.", {"camera_latency": (0.02, 0.05, 0.12)}, ball=True),
    "camera_scale": HiddenEffect(
        "The camera's scale is wrong.", {"camera_scale": (0.02, 0.05, 0.1)}, ball=True, signed=True, factor=True
    ),
    # Outside the library: a diagnosis should say "unknown".
    "cogging": HiddenEffect("The motor's magnets hold it at some angles.", {"cogging": (0.08, 0.2, 0.45)}, known=False),
    "thermal_drift": HiddenEffect(
        "Warming changes friction and the angle measured, over the whole session.",
        {
            "thermal_warmup": (10.0, 20.0, 30.0),
            "thermal_bias": (2e-4, 5e-4, 1e-3),
            "thermal_friction": (0.01, 0.02, 0.025),
        },
        known=False,
    ),
    "lugre_presliding": HiddenEffect(
        "Friction yields like a spring before it slides.",
        {
            "bristle": (15.0, 12.0, 10.0),
            "bristle_damping": (0.05, 0.05, 0.05),
            "coulomb": (0.15, 0.3, 0.6),
            "static": (0.05, 0.1, 0.2),
        },
        known=False,
    ),
    "loose_mount": HiddenEffect(
        "The servo slips in its mount.",
        {"mount_play": (0.006, 0.015, 0.030), "mount_friction": (0.04, 0.04, 0.04)},
        known=False,
    ),
    "irregular_commands": HiddenEffect(
        "Commands come at uneven times, and some not at all.",
        {"command_jitter": (0.012, 0.025, 0.050), "command_loss": (0.1, 0.2, 0.35)},
        known=False,
    ),
}

# Other words for the same, as people say them.
ALIASES = {
    "coulomb": "coulomb_friction",
    "viscous": "viscous_friction",
    "stribeck": "stribeck_friction",
    "directional_friction": "direction_friction",
    "cross_axis": "cross_coupling",
    "position_error": "positioning_error",
    "saturation": "torque_saturation",
    "not_level": "board_not_level",
}
