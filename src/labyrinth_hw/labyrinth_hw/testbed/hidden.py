# SPDX-License-Identifier: Apache-2.0
"""Reads what an emulated rig is like, and what is wrong with it: `config/testbed/*.yaml`, command line, or drawn."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from labyrinth_hw import config
from labyrinth_hw.control_tables import servo_model
from labyrinth_hw.errors import InputError, unknown_name
from labyrinth_hw.registers import ServoModel
from labyrinth_hw.testbed.effects import ALIASES, EFFECTS, STRENGTHS
from labyrinth_hw.testbed.parameters import AXES, HEALTHY, QUANTITIES, Reality

SENSORS = ("motor_x", "motor_y", "board_x", "board_y")
KEYS = {"description", "servo", "baud", "sensor_baud", "layout", "quantities", "hidden"}


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
    """

    __test__ = False  # no test class, whatever its name

    name: str
    reality: Reality
    hidden: tuple[Hidden, ...]
    servo: ServoModel
    baud: int = 1_000_000
    sensor_baud: int = 115_200
    layout: str = "medium"

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
    places = SENSORS if sensor else (*AXES, "both")
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
    """Something wrong, drawn at random.

    Args:
        seed: the same seed draws the same.
        known: from the effects the library knows, those it does not, or (None) from all.
        ball: whether effects on the ball may be drawn.
        strength: fixed, or None to draw it too.
    """
    rng = np.random.default_rng([seed, 7])
    names = [n for n, e in EFFECTS.items() if (known is None or e.known == known) and (ball or not e.ball)]
    name = str(rng.choice(names))
    level = strength or str(rng.choice(STRENGTHS))
    axis = str(rng.choice(SENSORS if EFFECTS[name].sensor else AXES))
    return hide(name, axis, level, sign=int(rng.choice([-1, 1])))


def parse_effect(text: str) -> Hidden:
    """`NAME[.AXIS][=STRENGTH]` of the command line."""
    rest, _, strength = text.partition("=")
    name, _, axis = rest.partition(".")
    return hide(name, axis or "x", strength or "strong")


def load_testbed(name: str | Path, effects: Sequence[str] = (), draw_seed: int | None = None) -> TestbedConfig:
    """An emulated rig from its file, with more hidden in it from the command line.

    Raises:
        InputError: all complaints about the file at once.
    """
    content = config.load("testbed", name)
    return build(content, str(name), effects, draw_seed)


def build(
    content: Mapping[str, Any], name: str, effects: Sequence[str] = (), draw_seed: int | None = None
) -> TestbedConfig:
    """An emulated rig from the content of its file."""
    complaints = [unknown_name(f"key in {name}", key, KEYS) for key in content if key not in KEYS]
    hidden: list[Hidden] = []
    reality, servo = HEALTHY, servo_model("MX-64")
    try:
        servo = servo_model(str(content.get("servo", "MX-64")))
        reality = reality.with_values({"encoder_tick": servo.tick})
    except InputError as error:
        complaints += error.complaints
    try:
        reality = reality.with_values(content.get("quantities") or {})
    except InputError as error:
        complaints += error.complaints
    for entry in content.get("hidden") or ():
        try:
            if (
                not isinstance(entry, Mapping)
                or set(entry) - {"effect", "axis", "strength", "values"}
                or "effect" not in entry
            ):
                raise InputError(
                    f"hidden: expected {{effect: NAME, axis: x, strength: strong}} or values:, got {entry!r}."
                )
            hidden.append(hide(**{"axis": "x", **entry}))
        except InputError as error:
            complaints += error.complaints
    for text in effects:
        try:
            hidden.append(parse_effect(text))
        except InputError as error:
            complaints += error.complaints
    if draw_seed is not None:
        hidden.append(draw(draw_seed))
    for item in hidden:
        try:
            reality = item.applied(reality)
        except InputError as error:
            complaints += error.complaints
    if complaints:
        raise InputError(complaints)
    return TestbedConfig(
        name=name,
        reality=reality,
        hidden=tuple(hidden),
        servo=servo,
        baud=int(content.get("baud", 1_000_000)),
        sensor_baud=int(content.get("sensor_baud", 115_200)),
        layout=str(content.get("layout", "medium")),
    )


def listing() -> str:
    """Rigs and effects in lines for the terminal."""
    lines = ["Rigs:"] + [f"  {name}" for name in config.names("testbed")] + ["Effects:"]
    for name, effect in EFFECTS.items():
        where = "ball" if effect.ball else "sensor" if effect.sensor else "axis"
        lines.append(f"  {name:22s}{where:8s}{'' if effect.known else 'outside the library; '}{effect.text}")
    return "\n".join(lines)
