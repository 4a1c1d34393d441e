# SPDX-License-Identifier: Apache-2.0
"""What an emulated rig is like and what is wrong with it: `config/testbed/*.yaml`, command line, or drawn at random."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import isfinite, nan
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, Field, PrivateAttr, field_validator, model_validator

from labyrinth_hw import config
from labyrinth_hw.config import Number, Section, Whole
from labyrinth_hw.control_tables import ServoModel, servo_model
from labyrinth_hw.errors import InputError, unknown_name
from labyrinth_hw.motors import OPERATING_MODES
from labyrinth_hw.testbed.quantities import AXES, HEALTHY, QUANTITIES, Reality

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
    "supply_sag": HiddenEffect("The supply voltage drops under load.", {"supply_resistance": (10.0, 15.0, 40.0)}),
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
    "rolling_friction": HiddenEffect(
        "The ball rolls with more resistance.", {"rolling_friction": (0.006, 0.012, 0.03)}, ball=True
    ),
    "restitution": HiddenEffect("Walls absorb the ball's speed.", {"restitution": (0.35, 0.2, 0.05)}, ball=True),
    "board_not_level": HiddenEffect(
        "The rig is not level.", {"not_level": (0.003, 0.008, 0.02)}, ball=True, signed=True
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


SENSOR_SIGNALS = ("motor_x", "motor_y", "board_x", "board_y")


@dataclass(frozen=True)
class Hidden:
    """One thing that is wrong.

    Attributes:
        effect: name, from `EFFECTS`.
        axis: "x", "y", "both"; for a sensor's effect "motor_x", "motor_y", "board_x" or "board_y".
        strength: "weak", "medium", "strong", or "given" where values were.
        values: quantity -> value, what is changed.
    """

    effect: str
    axis: str
    strength: str
    values: Mapping[str, float]

    @property
    def name(self) -> str:
        """effect.axis, or the effect alone where it acts on the ball or on both axes."""
        return self.effect if self.axis == "both" else f"{self.effect}.{self.axis}"

    def applied(self, reality: Reality) -> Reality:
        """The rig with this wrong."""
        axes = AXES if self.axis == "both" else (self.axis[-1],)
        return reality.with_values({name: dict.fromkeys(axes, value) for name, value in self.values.items()})


@dataclass(frozen=True)
class TestbedConfig:
    """An emulated rig.

    Attributes:
        name: of the file.
        reality: its quantities, everything hidden included.
        hidden: what is wrong.
        servo: control table of both servos.
        baud, sensor_baud: of the two lines, bits per second.
        layout: of the walls and holes.
        tilt_rate: Hz of the camera's pictures that give the board's tilt; None where potentiometers do.
        marble: BGR colour of a painted marble; None for steel.
        mode: operating mode that the servos' EEPROM has; None for the factory's.
    """

    __test__ = False  # not a test class, despite its name

    name: str
    reality: Reality
    hidden: tuple[Hidden, ...]
    servo: ServoModel
    baud: int = 1_000_000
    sensor_baud: int = 115_200
    layout: str = "medium"
    tilt_rate: float | None = None
    marble: tuple[int, int, int] | None = None
    mode: int | None = None

    def revealed(self) -> dict[str, Any]:
        """What is wrong, as plain values for a JSON file."""
        return {
            "config": self.name,
            "hidden": [
                {"effect": h.effect, "axis": h.axis, "strength": h.strength, "known": EFFECTS[h.effect].known,
                 "values": {k: {"value": v, "unit": QUANTITIES[k].unit} for k, v in h.values.items()}}
                for h in self.hidden
            ],
        }  # fmt: skip


def _known_quantity(name: str) -> str:
    if name not in QUANTITIES:
        raise InputError(unknown_name("quantity", name, QUANTITIES))
    return name


class AxisValues(Section):
    """A quantity for each axis; one left out keeps its value."""

    x: Number | None = None
    y: Number | None = None

    @model_validator(mode="before")
    @classmethod
    def _both(cls, value: object) -> object:
        if isinstance(value, Mapping):
            return value
        try:
            number = float(value)  # type: ignore[arg-type]
        except (TypeError, ValueError):
            number = nan
        if isinstance(value, bool) or not isfinite(number):
            raise ValueError(f"expected a number, or {{x: NUMBER, y: NUMBER}}, got {value!r}")
        return {"x": number, "y": number}

    def given(self) -> dict[str, float]:
        """Axis -> value of what was given."""
        return {axis: value for axis, value in (("x", self.x), ("y", self.y)) if value is not None}


def hide(
    effect: str, axis: str = "x", strength: str = "strong", values: Mapping[str, float] | None = None, sign: int = 1
) -> Hidden:
    """Something wrong, by name and strength, or with its own values.

    Raises:
        InputError: unknown names; lists the valid ones.
    """
    complaints = []
    effect = ALIASES.get(effect, effect)
    sensor = effect in EFFECTS and EFFECTS[effect].sensor
    axis = f"motor_{axis}" if sensor and axis in AXES else axis
    places = SENSOR_SIGNALS if sensor else (*AXES, "both")
    if effect not in EFFECTS:
        complaints.append(unknown_name("hidden effect", effect, EFFECTS))
    elif axis not in places:
        complaints.append(unknown_name("axis", axis, places))
    if strength not in (*STRENGTHS, "given"):
        complaints.append(unknown_name("strength", strength, STRENGTHS))
    if complaints:
        raise InputError(complaints)
    entry = EFFECTS[effect]
    if values:
        for name in values:
            _known_quantity(name)
        return Hidden(effect, axis, "given", dict(values))
    level = STRENGTHS.index("strong" if strength == "given" else strength)
    changes = {name: levels[level] for name, levels in entry.quantities.items()}
    if axis.startswith("board_"):
        changes = {name.replace("encoder", "pot"): value for name, value in changes.items()}
    first = next(iter(changes))
    signed = sign if entry.signed else 1
    changes[first] = 1.0 + signed * changes[first] if entry.factor else signed * changes[first]
    return Hidden(effect, axis, strength, changes)


def draw(seed: int, *, known: bool | None = True, ball: bool = False, strength: str | None = None) -> Hidden:
    """Something wrong, picked at random.

    Args:
        seed: the same seed picks the same.
        known: from the effects the library knows, those it does not, or (None) from all.
        ball: whether effects on the ball may be picked.
        strength: fixed, or None to pick it too.
    """
    rng = np.random.default_rng([seed, 7])
    names = [n for n, e in EFFECTS.items() if (known is None or e.known == known) and (ball or not e.ball)]
    name = str(rng.choice(names))
    level = strength or str(rng.choice(STRENGTHS))
    axis = str(rng.choice(SENSOR_SIGNALS if EFFECTS[name].sensor else AXES))
    return hide(name, axis, level, sign=int(rng.choice([-1, 1])))


def parse_effect(text: str) -> Hidden:
    """`NAME[.AXIS][=STRENGTH]` of the command line."""
    rest, _, strength = text.partition("=")
    name, _, axis = rest.partition(".")
    return hide(name, axis or "x", strength or "strong")


class HiddenSection(Section):
    """One thing that is wrong, by strength or by its own values; see `hide`."""

    effect: str
    axis: str = "x"
    strength: str = "strong"
    values: Mapping[str, Number] | None = None
    _hidden: Hidden = PrivateAttr()

    @model_validator(mode="after")
    def _known(self) -> "HiddenSection":
        self._hidden = hide(self.effect, self.axis, self.strength, self.values)
        return self

    @property
    def hidden(self) -> Hidden:
        """What is wrong."""
        return self._hidden


Byte = Annotated[Whole, Field(ge=0, le=255)]


class TestbedFile(Section):
    """config/testbed/*.yaml as it stands."""

    __test__ = False

    description: str = ""
    servo: str = "MX-64"
    baud: Annotated[Whole, Field(gt=0)] = 1_000_000
    sensor_baud: Annotated[Whole, Field(gt=0)] = 115_200
    layout: str = "medium"
    tilt_rate_hz: Annotated[Number, Field(gt=0, le=200)] | None = None
    marble_rgb: tuple[Byte, Byte, Byte] | None = None
    operating_mode: Literal["current", "position", "extended_position", "current_based_position"] | None = None
    quantities: Mapping[Annotated[str, AfterValidator(_known_quantity)], AxisValues] = {}
    hidden: tuple[HiddenSection, ...] = ()

    @field_validator("servo")
    @classmethod
    def _known_servo(cls, name: str) -> str:
        return servo_model(name).name


def load_testbed(name: str | Path, effects: Sequence[str] = (), draw_seed: int | None = None) -> TestbedConfig:
    """An emulated rig from its file, with more hidden in it from the command line.

    Args:
        name: of a file in config/testbed, or a path.
        effects: `NAME[.AXIS][=STRENGTH]` each.
        draw_seed: hides one more effect, picked at random by this seed; None picks none.

    Raises:
        InputError: all complaints about the file, then all about the effects.
    """
    given = config.read(config.find("testbed", name)).checked(TestbedFile)
    return build(given, str(name), effects, draw_seed)


def build(given: TestbedFile, name: str, effects: Sequence[str] = (), draw_seed: int | None = None) -> TestbedConfig:
    """An emulated rig from the content of its file. Raises InputError for unknown effects."""
    hidden = [section.hidden for section in given.hidden]
    complaints: list[str] = []
    for text in effects:
        try:
            hidden.append(parse_effect(text))
        except InputError as error:
            complaints += error.complaints
    if complaints:
        raise InputError(complaints)
    if draw_seed is not None:
        hidden.append(draw(draw_seed))
    servo = servo_model(given.servo)
    reality = HEALTHY.with_values({"encoder_tick": servo.tick}).with_values(
        {key: value.given() for key, value in given.quantities.items()}
    )
    for item in hidden:
        reality = item.applied(reality)
    return TestbedConfig(
        name=name,
        reality=reality,
        hidden=tuple(hidden),
        servo=servo,
        baud=given.baud,
        sensor_baud=given.sensor_baud,
        layout=given.layout,
        tilt_rate=given.tilt_rate_hz,
        mode=None if given.operating_mode is None else OPERATING_MODES[given.operating_mode],
        marble=given.marble_rgb[::-1] if given.marble_rgb else None,
    )


def listing() -> str:
    """Rigs and effects in lines for the terminal."""
    lines = ["Rigs:"] + [f"  {name}" for name in config.names("testbed")] + ["Effects:"]
    for name, effect in EFFECTS.items():
        where = "ball" if effect.ball else "sensor" if effect.sensor else "axis"
        lines.append(f"  {name:22s}{where:8s}{'' if effect.known else 'outside the library; '}{effect.text}")
    return "\n".join(lines)
