# SPDX-License-Identifier: Apache-2.0
"""Sequences in angles of the load, for rigs whose motor turns further than what it drives."""

import numpy as np
import pytest

from eps_tunnel_analysis.sequence_file import find_sequence, parse_sequence
from labyrinth_sim.errors import InputError
from labyrinth_sim.model import load_model

PLAIN = {
    "initial_deg": {"a": 1.0, "b": 0.0},
    "command": {
        "a": [
            {"step": {"to_deg": 2.0, "lasts_s": 1.0}},
            {"sine": {"amplitude": 0.02, "frequency_hz": 1, "lasts_s": 1}},
        ],
        "b": [{"ramp": {"to_deg": 2.0, "lasts_s": 2.0}}],
    },
}


def test_angles_of_the_load_are_divided_by_the_ratio_and_nothing_else_is() -> None:
    plain = parse_sequence(PLAIN, "s", "s").commands[0]
    given = parse_sequence({**PLAIN, "ratio": {"a": 0.1}}, "s", "s").commands[0]
    time, targets = plain.sample(100.0)
    again, others = given.sample(100.0)
    assert (again == time).all()
    assert others == pytest.approx(targets * np.array([10.0, 1.0]))


@pytest.mark.parametrize(
    ("ratio", "words"), [({"c": 0.1}, "channel"), ({"a": 0.0}, "ratio"), ({"a": "tenth"}, "ratio")]
)
def test_a_ratio_that_is_none_is_refused(ratio: dict, words: str) -> None:
    with pytest.raises(InputError, match=words):
        parse_sequence({**PLAIN, "ratio": ratio}, "s", "s")


def test_the_sequence_of_cyberrunner_keeps_within_its_rig() -> None:
    command, rig = find_sequence("cyberrunner_12s").commands[0], load_model("cyberrunner").rig
    _, targets = command.sample(100.0)
    for channel, column in zip(command.channels, targets.T, strict=True):
        low, high = next(axis.limits for axis in rig.axes if axis.command == channel)
        assert 0.3 * high < np.abs(column).max() < high and low == -high
