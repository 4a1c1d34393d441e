# SPDX-License-Identifier: Apache-2.0
"""compare, calibrate and diagnose give the frozen results on three small studies; see frozen_studies.py."""

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from frozen_studies import FILES, FROZEN, Laboratory, Tolerance, differences, flat, frozen, same

LONG = ("late_horn_diagnose", "unbalanced_labyrinth_diagnose")


@pytest.fixture(scope="module")
def laboratory(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Laboratory]:
    return Laboratory(tmp_path_factory.mktemp("studies"))


@pytest.mark.parametrize("name", [pytest.param(name, marks=[pytest.mark.study] * (name in LONG)) for name in FILES])
def test_the_result_is_the_frozen_one(laboratory: Laboratory, name: str) -> None:
    lines = differences(name, frozen(name), laboratory.result(name))
    if lines:
        pytest.fail(
            f"{name}: {len(lines)} values differ from test/frozen/{name}.json.\n  " + "\n  ".join(lines)
            + f"\nIf the change is intended: python test/frozen_studies.py --write {name}; say why in CHANGELOG.md.",
            pytrace=False,
        )  # fmt: skip


def test_every_frozen_file_is_compared() -> None:
    assert sorted(file.stem for file in FROZEN.iterdir()) == sorted(FILES)


def test_a_difference_is_listed_with_its_key_and_both_values() -> None:
    before = {"errors": [{"rms": 1.0, "unit": "rad"}], "notes": [], "gone": 3}
    now = {"errors": [{"rms": 1.00001, "unit": "m"}], "notes": ["new"], "gone": None}
    assert differences("late_horn_compare", before, now) == [
        "errors[0].rms: frozen 1.0, now 1.00001",
        "errors[0].unit: frozen 'rad', now 'm'",
        "notes: frozen [], now 'absent'",
        "gone: frozen 3, now None",
        "notes[0]: frozen 'absent', now 'new'",
    ]
    assert not differences("late_horn_compare", before, {**before, "errors": [{"rms": 1.0000001, "unit": "rad"}]})


def test_only_numbers_have_a_tolerance() -> None:
    wide = Tolerance(0.5, 0.0)
    assert same(1.0, 1.4, wide) and same(2, 2.1, wide)
    assert not same(2, 3, wide) and not same(1.0, None, wide) and not same(True, 1, wide)
    assert dict(flat({"a": [{"b": 1}, 2], "c": {}})) == {"a[0].b": 1, "a[1]": 2, "c": {}}
