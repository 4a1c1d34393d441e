# SPDX-License-Identifier: Apache-2.0
from pathlib import Path

import numpy as np
import pytest

from labyrinth_sim.effect import effects
from labyrinth_sim.effects_page import page, picture

DOCS = Path(__file__).resolve().parents[1] / "docs"
REMEDY = "run python -m labyrinth_sim.effects_page in the root of the source tree"


def test_the_page_is_up_to_date() -> None:
    assert (DOCS / "effects.md").read_text(encoding="utf-8") == page(), REMEDY


def test_every_effect_has_its_picture() -> None:
    assert {file.stem for file in (DOCS / "effects").glob("*.svg")} == set(effects()), REMEDY


def numbers(svg: str) -> np.ndarray:
    lines = [line.split('points="')[1].split('"')[0] for line in svg.splitlines() if "polyline" in line]
    return np.array([[float(v) for v in pair.split(",")] for line in lines for pair in line.split()])


def test_a_picture_is_up_to_date() -> None:
    effect = next(iter(effects().values()))
    drawn = numbers((DOCS / "effects" / f"{effect.name}.svg").read_text(encoding="utf-8"))
    # Other processors round differently in the last bits of a simulation.
    assert numbers(picture(effect)) == pytest.approx(drawn, abs=1.0), REMEDY


def test_those_mistaken_for_one_another_exist() -> None:
    library = effects()
    for effect in library.values():
        assert effect.confused_with, effect.name
        assert set(effect.confused_with) <= set(library) - {effect.name}


def test_who_is_mistaken_for_another_says_so_as_well() -> None:
    library = effects()
    pairs = {(effect.name, other) for effect in library.values() for other in effect.confused_with}
    assert pairs == {(other, name) for name, other in pairs}
