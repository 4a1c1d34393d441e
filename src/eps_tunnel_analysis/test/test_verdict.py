# SPDX-License-Identifier: Apache-2.0
"""From probabilities to the verdict and its words."""

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from eps_tunnel_analysis.diagnose.rank import (
    NONE,
    OVERLOOKED,
    UNKNOWN,
    joint,
    name_of,
    smallest_set,
    with_imitated,
    with_overlooked,
)
from eps_tunnel_analysis.diagnose.settings import SETTINGS
from eps_tunnel_analysis.diagnose.verdict import AxisVerdict, decide, sentence
from labyrinth_sim.registry import Registry


def test_part_of_what_is_unknown_may_be_known_effects_that_were_not_found() -> None:
    found = with_overlooked({UNKNOWN: 0.8, NONE: 0.15, "a.x": 0.05})
    assert found[UNKNOWN] + found[OVERLOOKED] == pytest.approx(0.8)
    assert found[OVERLOOKED] == pytest.approx(0.8 * SETTINGS.overlooked)
    assert list(found) == [UNKNOWN, OVERLOOKED, NONE, "a.x"], "most probable first"
    kind, named, stated = decide(found, SETTINGS.coverage)
    assert (kind, named, stated) == ("unknown", (), (UNKNOWN, OVERLOOKED, NONE))
    assert with_overlooked({NONE: 1.0, UNKNOWN: 0.0}) == {NONE: 1.0, UNKNOWN: 0.0}


def test_part_of_what_is_named_may_be_something_that_behaves_like_it() -> None:
    itself = 1.0 - SETTINGS.imitated
    found = with_imitated({"a.x": 0.6, "a.x + b.y": 0.3, NONE: 0.06, UNKNOWN: 0.04})
    assert sum(found.values()) == pytest.approx(1.0)
    assert found["a.x"] == pytest.approx(0.6 * itself)
    assert found["a.x + b.y"] == pytest.approx(0.3 * itself), "whatever their number"
    assert (found[NONE], found[UNKNOWN]) == (0.06, 0.04), "what names nothing is imitated by nothing"
    assert list(found) == sorted(found, key=lambda name: -found[name]), "most probable first"
    assert with_imitated({NONE: 1.0, UNKNOWN: 0.0}) == {NONE: 1.0, UNKNOWN: 0.0}
    said = sentence("effect", ("a.x",), ("a.x",), with_imitated({"a.x": 0.99, NONE: 0.01}), {}, Registry.load())
    assert said == "The model lacks a on x (74%), or something that behaves like it (25%)."
    said = sentence("undecided", ("a.x",), ("a.x", "b.x"), with_imitated({"a.x": 0.5, "b.x": 0.5}), {}, Registry.load())
    assert said.endswith("between a on x (38%) and b on x (38%); something else may behave like them (25%).")


def test_axes_are_joined_as_products() -> None:
    found = joint([{"a.x": 0.8, NONE: 0.1, UNKNOWN: 0.1}, {"b.y": 0.5, NONE: 0.5}])
    assert sum(found.values()) == pytest.approx(1.0)
    assert found["a.x + b.y"] == pytest.approx(0.4)
    assert found["a.x"] == pytest.approx(0.4)
    assert found[UNKNOWN] == pytest.approx(0.1)


@given(st.lists(st.floats(0.01, 1.0), min_size=1, max_size=6), st.floats(0.5, 0.99))
def test_the_stated_set_is_the_smallest_that_covers(weights: list[float], coverage: float) -> None:
    found = {f"e{i}": w / sum(weights) for i, w in enumerate(weights)}
    stated = smallest_set(found, coverage)
    assert sum(found[n] for n in stated) >= coverage - 1e-9
    for fewer in itertools.combinations(found, len(stated) - 1):
        assert sum(found[n] for n in fewer) < coverage


@pytest.mark.parametrize(
    ("found", "kind", "effects"),
    [
        ({NONE: 0.95, "a.x": 0.05}, "complete", ()),
        ({"a.x": 0.95, UNKNOWN: 0.05}, "effect", ("a.x",)),
        ({"a.x + b.y": 0.95, UNKNOWN: 0.05}, "effect", ("a.x", "b.y")),
        ({"a.x": 0.6, "b.x": 0.4}, "undecided", ("a.x",)),
        ({UNKNOWN: 0.6, "a.x": 0.4}, "unknown", ()),
        ({UNKNOWN: 0.35, "a.x + b.y": 0.28, "c.x + b.y": 0.25, OVERLOOKED: 0.12}, "undecided", ("a.x", "b.y")),
        ({UNKNOWN: 0.45, "a.x": 0.25, OVERLOOKED: 0.15, "c.x": 0.15}, "unknown", ()),
        ({NONE: 0.45, "a.x": 0.3, "c.x": 0.25}, "undecided", ()),
    ],
)
def test_four_verdicts(found: dict[str, float], kind: str, effects: tuple[str, ...]) -> None:
    said, named, stated = decide(found, 0.9)
    assert (said, named) == (kind, effects)
    assert sentence(said, named, stated, {NONE: 0.0, UNKNOWN: 0.0, **found}, {}, Registry.load())


def axis(base: float, after: float, explained: dict[str, float], unknown: float, **marginals: float) -> AxisVerdict:
    return AxisVerdict(
        marginals={name.replace("_on_", "."): p for name, p in marginals.items()},
        none=1.0 - unknown - sum(marginals.values()),
        unknown=unknown,
        explained={name: (share, share - 0.1, share + 0.1) for name, share in explained.items()},
        remaining={},
        floors=(base, after),
        not_converged=(),
        ranking=(),
    )


def test_where_the_whole_is_open_each_axis_says_what_is_clear_of_it() -> None:
    axes = {
        "x": axis(80.0, 2.0, {"backlash.x": 0.97}, 0.02, backlash_on_x=0.75),
        "y": axis(40.0, 15.0, {"gain_error.y": 0.6}, 0.9, gain_error_on_y=0.1),
        "z": axis(1.1, 1.1, {}, 0.03),
        "u": axis(90.0, 5.0, {"load_friction.u": 0.95, "coulomb_friction.u": 0.9}, 0.0,
                  load_friction_on_u=0.62, coulomb_friction_on_u=0.38),
        "v": axis(1.3, 1.0, {"gain_error.v": 0.6}, 0.1, gain_error_on_v=0.2),
    }  # fmt: skip
    said = sentence("unknown", (), (UNKNOWN,), {UNKNOWN: 0.7, OVERLOOKED: 0.2}, axes, Registry.load())
    assert said.startswith(
        "Something is missing that no known effect explains in full (70%), "
        "or a combination of known effects that was not found (20%). "
    )
    assert "Backlash (belt slack) on x (75%) explains 97% of what the model leaves there." in said
    assert "On y gain error on y explains 60% of 40 floors." in said
    assert "Nothing is missing on z, 1.1 floors." in said
    assert "On u load-dependent friction on u explains 95% of 90 floors." in said
    assert said.endswith("On v 1.3 floors remain.")


def test_what_forms_of_added_effects_leave_is_not_called_noise() -> None:
    axes = {"x": axis(74.0, 74.0, {}, 0.0), "y": axis(1.0, 1.0, {}, 0.0)}
    said = sentence("complete", (), (NONE,), {NONE: 0.98}, axes, Registry.load())
    assert said == (
        "Nothing more is named (98%): what is left, 74 floors on x, may be an error of the form of what was added "
        "before."
    )
    said = sentence("complete", (), (NONE,), {NONE: 0.98}, {"x": axis(1.9, 1.9, {}, 0.0)}, Registry.load())
    assert said == "Nothing is missing within the noise (98%)."


def test_what_is_clear_though_it_acts_in_no_set_alone_has_no_share_of_its_own() -> None:
    sets = {"backlash.x + gain_error.x": 0.95, "backlash.x + sensor_bias.x": 0.9, "gain_error.x": 0.99}
    part = axis(80.0, 2.0, sets, 0.02, backlash_on_x=0.75, gain_error_on_x=0.4)
    said = sentence("unknown", (), (UNKNOWN,), {UNKNOWN: 0.7}, {"x": part}, Registry.load())
    assert said.endswith("Backlash (belt slack) on x (75%) is part of every likely set; the best explains 95%.")


def test_names_do_not_depend_on_the_order_in_which_effects_were_added() -> None:
    assert name_of(["b.y", "a.x"]) == name_of(["a.x", "b.y"]) == "a.x + b.y"
