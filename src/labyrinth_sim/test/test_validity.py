# SPDX-License-Identifier: Apache-2.0
"""The section `valid` of a model's file."""

from dataclasses import replace
from pathlib import Path

import pytest

from labyrinth_sim.errors import InputError
from labyrinth_sim.model import Model, load_model, save_model
from labyrinth_sim.validity import ShownSignal, Validity

VALID = Validity(
    {
        "motor_x": ShownSignal("rad", -0.05, 0.06, 1.2, 0.0003),
        "motor_x_effort": ShownSignal("N m", -0.5, 0.4),
    },
    ("excite",),
    ("bags/one 0123456789ab",),
)


def saved(folder: Path, valid: Validity | None = VALID) -> Path:
    return save_model(replace(load_model("labyrinth"), valid=valid), folder / "mine.yaml")


def test_it_is_written_and_read_as_it_is(tmp_path: Path) -> None:
    assert load_model(saved(tmp_path)).valid == VALID
    assert load_model("labyrinth").valid is None


def test_another_value_or_effect_was_not_shown_to_hold(tmp_path: Path) -> None:
    model = load_model(saved(tmp_path))
    others: list[Model] = [model.with_values({"drive.x.p": 3.0}), model.with_effect("backlash", "x")]
    assert [m.valid for m in others] == [None, None]
    assert model.with_values({}).valid == VALID


@pytest.mark.parametrize(
    ("right", "wrong", "complaint"),
    [
        ("motor_x:", "motor_z:", "Unknown signal 'motor_z'"),
        ("unit: rad", "unit: deg", "measured in rad, got unit 'deg'"),
        ("low: -0.05", "low: 0.5", "'low' must not lie above 'high'"),
        ("speed: 1.2", "speed: -1.2", "speed"),
        ("high: 0.06", "highest: 0.06", "highest"),
        ("held_out:", "heldout:", "held_out"),
    ],
)
def test_what_is_wrong_is_said_with_its_line(tmp_path: Path, right: str, wrong: str, complaint: str) -> None:
    file = saved(tmp_path)
    text = file.read_text()
    assert right in text
    file.write_text(text.replace(right, wrong, 1) if right != "motor_x:" else text.replace("  motor_x:", "  motor_z:"))
    with pytest.raises(InputError, match=complaint) as refused:
        load_model(file)
    assert f"{file}:" in str(refused.value)
