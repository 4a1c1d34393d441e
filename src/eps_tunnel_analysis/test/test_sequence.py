# SPDX-License-Identifier: Apache-2.0
import contextlib
import math
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from eps_tunnel_analysis.sequence import SHAPES, Chirp, Command, Hold, Prbs, Ramp, Sequence, Shape, Sine, Step, Triangle
from eps_tunnel_analysis.sequence_file import find_sequence, load_sequence, parse_sequence, sequence_text
from labyrinth_sim import config
from labyrinth_sim.errors import InputError
from labyrinth_sim.yaml_file import parse_yaml

angles = st.floats(-0.2, 0.2)
lengths = st.integers(1, 60).map(lambda n: n / 20)
rates = st.floats(0.1, 5.0)
shapes = st.one_of(
    st.builds(Hold, lengths),
    st.builds(Step, lengths, angles),
    st.builds(Ramp, lengths, angles),
    st.builds(Sine, lengths, angles, rates),
    st.builds(Triangle, lengths, angles, rates),
    st.builds(Chirp, lengths, angles, rates, rates),
    st.builds(Prbs, lengths, angles, lengths, st.integers(2, 9)),
)
rows = st.lists(shapes, min_size=1, max_size=5).map(tuple)
commands = st.builds(
    lambda initial, x, y: Command("any", ("motor_x", "motor_y"), initial, (x, y)), st.tuples(angles, angles), rows, rows
)


@given(commands)
def test_a_sampled_command_stays_within_its_reach_and_lasts_as_it_says(command: Command) -> None:
    time, values = command.sample(100.0)
    assert values.shape == (len(time), 2)
    assert len(time) == round(command.duration * 100)
    assert np.allclose(time, np.arange(len(time)) / 100)
    for column, (low, high) in enumerate(command.reach().values()):
        assert values[:, column].min() >= low - 1e-12
        assert values[:, column].max() <= high + 1e-12


@given(commands, st.sampled_from([2, 5]))
def test_a_slower_rate_sees_the_same_command(command: Command, every: int) -> None:
    _, fine = command.sample(100.0)
    _, coarse = command.sample(100.0 / every)
    assert np.allclose(fine[::every], coarse, atol=1e-6)


@given(rows, st.floats(-0.1, 0.1))
def test_a_swing_gives_its_base_back_and_a_target_is_kept(row: tuple[Shape, ...], initial: float) -> None:
    # The other channel outlasts the row by a second, so the last samples show what is held after it.
    other = (Hold(math.fsum(shape.lasts for shape in row) + 1.0),)
    _, values = Command("any", ("a", "b"), (initial, 0.0), (row, other)).sample(100.0)
    targets = [shape.to for shape in row if isinstance(shape, (Step, Ramp))]
    assert values[-50:, 0] == pytest.approx(targets[-1] if targets else initial)


def test_a_triangle_is_in_phase_with_its_sine() -> None:
    """A period of 0.8 s by hand: up, down twice as far, and up again, about the base."""
    seen = Triangle(0.8, 0.04, 1.25).values(np.arange(9) * 0.1, 0.01)
    assert seen == pytest.approx(0.01 + 0.04 * np.array([0.0, 0.5, 1.0, 0.5, 0.0, -0.5, -1.0, -0.5, 0.0]))


@pytest.mark.parametrize("word", sorted(SHAPES))
def test_the_readers_words_make_the_shapes_they_name(word: str) -> None:
    numbers = {
        "to_deg": 2.0, "amplitude_deg": 2.0, "frequency_hz": 1.0, "start_frequency_hz": 1.0,
        "end_frequency_hz": 3.0, "bit_s": 0.1, "register": 5, "lasts_s": 2.0,
    }  # fmt: skip
    needed = {key: numbers[key] for item in _fields(SHAPES[word]) for key in numbers if key.startswith(item)}
    sequence = parse_sequence(
        {"initial_deg": {"motor_x": 0}, "command": {"motor_x": [{word: needed}]}}, "any", "any.yaml"
    )
    _, values = sequence.commands[0].sample(100.0)
    assert np.degrees(np.abs(values)).max() == pytest.approx(0.0 if word == "hold" else 2.0, abs=0.05)


def _fields(shape: type[Shape]) -> list[str]:
    return [f"{name}_" if name in ("to", "frequency", "bit") else name for name in shape.__dataclass_fields__]


def test_the_papers_sequence_is_the_papers() -> None:
    sequence = find_sequence("paper_8s")
    (command,) = sequence.commands
    _, values = command.sample(100.0)
    expected = np.full((800, 2), 2.5)
    expected[:200, 0] = expected[400:600, 1] = -2.5
    assert np.array_equal(values, np.radians(expected))
    assert np.degrees(command.initial) == pytest.approx([2.5, 2.5])
    assert (sequence.trials, command.duration) == (10, 8.0)


@pytest.mark.parametrize(("axis", "top"), [("x", 5.0), ("y", 4.0)])
def test_single_rotations_go_from_zero_to_every_half_degree(axis: str, top: float) -> None:
    sequence = find_sequence(f"rotations_{axis}")
    targets = []
    for command in sequence.commands:
        assert command.initial == (0.0, 0.0)
        _, values = command.sample(100.0)
        column = command.channels.index(f"motor_{axis}")
        assert not values[:, 1 - column].any()
        assert np.ptp(values[:, column]) == 0
        targets.append(math.degrees(values[0, column]))
        assert command.name == f"rotations_{axis}/{targets[-1]:+.1f}deg"
    assert targets == pytest.approx([a for a in np.arange(-top, top + 0.1, 0.5) if a])
    assert len({command.hash for command in sequence.commands}) == len(targets)


@pytest.mark.parametrize(
    "path",
    [config.find("sequences", n) for n in config.names("sequences") if not n.startswith("cyberrunner")],
    ids=lambda p: p.stem,
)
def test_every_sequence_that_comes_along_stays_within_the_boards_limits(path: Path) -> None:
    sequence = load_sequence(path)
    sequence.check_limits(
        {"motor_x": (math.radians(-5), math.radians(5)), "motor_y": (math.radians(-4), math.radians(4))}
    )
    assert sequence.description


def test_the_excitation_moves_each_axis_alone_and_both_together() -> None:
    time, values = find_sequence("excite_12s").commands[0].sample(100.0)
    moving = np.abs(values) > 0
    assert len(time) == 1200
    for alone in (moving[:, 0] & ~moving[:, 1], moving[:, 1] & ~moving[:, 0], moving.all(axis=1)):
        assert alone.sum() > 200


TEXT = """
initial_deg: {motor_x: 1.5, motor_y: 0}
trials: 3
command:
  motor_x: [{step: {to_deg: 2, lasts_s: 1}}, {sine: {amplitude_deg: 1, frequency_hz: 2, lasts_s: 1}}]
"""


def parsed(text: str, name: str = "some") -> Sequence:
    return parse_sequence(yaml.safe_load(text), name, f"{name}.yaml")


def test_the_hash_is_blind_to_layout_and_unit_but_sees_every_number() -> None:
    one = parsed(TEXT)
    same = f"""# another layout
command:
  motor_x:
  - step: {{lasts_s: 1.0, to: {math.radians(2)!r}}}
  - sine:
      frequency_hz: 2.0
      lasts_s: 1
      amplitude_deg: 1
trials: 7
description: "other words"
initial_deg: {{motor_x: 1.5, motor_y: 0.0}}
"""
    assert parsed(same, "other").hash == one.hash
    for old, new in (
        ("to_deg: 2", "to_deg: 2.1"),
        ("1.5", "1.4"),
        ("frequency_hz: 2", "frequency_hz: 3"),
        ("sine", "triangle"),
    ):
        assert parsed(TEXT.replace(old, new)).hash != one.hash, new


def test_one_command_of_several_can_be_named() -> None:
    sequence = find_sequence("rotations_x/+2.5deg")
    assert [command.name for command in sequence.commands] == ["rotations_x/+2.5deg"]
    with pytest.raises(InputError, match=r"Did you mean 'rotations_x/\+2.5deg'"):
        find_sequence("rotations_x/+2.6deg")


def test_all_complaints_come_at_once() -> None:
    with pytest.raises(InputError) as caught:
        parse_sequence(
            {
                "trails": 3,
                "trials": 0,
                "initial_deg": {"motor_x": "1e1"},
                "command": {
                    "motor_x": [
                        {"step": {"to_deg": 1, "to": 1, "lasts_s": -1}},
                        {"stop": {}},
                        {"prbs": {"amplitude_deg": math.inf, "bit_s": 0.1, "register": 2.5, "lasts_s": True}},
                    ],
                    "motor_z": [],
                },
            },
            "bad",
            "bad.yaml",
        )
    told = str(caught.value)
    for part in (
        "bad.yaml: Unknown key 'trails'. Did you mean 'trials'?",
        "trials: must be greater than or equal to 1, got 0",
        "initial_deg.motor_x: expected a number, got '1e1'",
        "command.motor_x[0].step: expected one of to_deg, to_mm, to and no other",
        "command.motor_x[0].step.lasts_s: must be greater than 0 s, got -1",
        "command.motor_x[1].stop: Unknown shape 'stop'. Did you mean 'step'?",
        "amplitude_deg: expected a finite number, got inf",
        "register: expected a whole number, got 2.5",
        "lasts_s: expected a number, got True",
        "command.motor_z: Unknown channel 'motor_z'",
    ):
        assert part in told, part


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("", "expected a mapping"),
        ("[1, 2]", "expected a mapping"),
        ("a: [", "not valid YAML"),
        ("trials: 1\ntrials: 2", ":2: the key 'trials' is given twice"),
        ("initial_deg: {a: 0}", "either 'command' (one) or 'commands'"),
        ("initial_deg: {a: 0}\ncommands: {}", "expected a mapping from name to command"),
        ("initial_deg: {a: 0}\ncommand: {a: []}", "expected a list of shapes"),
        ("initial_deg: {a: 0}\ncommand: {a: [{hold: {}}]}", ":2: command.a[0].hold: 'lasts_s' is missing"),
        ("initial_deg: {a: 0}\ncommand: {a: [{hold: 3}]}", "command.a[0].hold: expected a mapping, got 3"),
        ("initial_deg: {a: 0}\ncommand: {a: [{step: {lasts_s: 1}}]}", "expected one of to_deg, to_mm, to."),
        ("initial_deg: {a: 0}\ninitial: {a: 0}\ncommand: {a: [{hold: {lasts_s: 1}}]}", "initial target already"),
        ("initial_deg: {a: 0}\ncommand: {a: [{hold: {lasts_s: 1e9}}]}", "less than or equal to 3600 s"),
        (f"initial_deg: {{a: 0}}\ncommand: {{a: [{'{hold: {lasts_s: 3600}}, ' * 5}]}}", "lasts longer than 14400 s"),
        ("initial_deg: {a: 0}\ncommand: {a: [{sine: {amplitude: 1, frequency_hz: 1e9, lasts_s: 1}}]}", "10000 Hz"),
        ("initial_deg: {a: 0}\ntrials: 1000000000000\ncommand: {a: [{hold: {lasts_s: 1}}]}", "trials: must be less"),
        ("initial_deg: {1: 0, null: 1}\ncommand: 3", "command: expected a mapping, got 3"),
        ("initial_deg: 2020-99-99\ncommand: {a: [{hold: {lasts_s: 1}}]}", "got '2020-99-99'"),
        ("initial_deg: {a: 0}\ncommands: []", "commands: expected a mapping, got []"),
    ],
)
def test_a_bad_file_is_named_with_what_is_wrong(tmp_path: Path, text: str, complaint: str) -> None:
    path = tmp_path / "broken.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError) as caught:
        load_sequence(path)
    assert complaint in str(caught.value)
    assert str(path) in str(caught.value)


def test_an_unknown_sequence_lists_those_there_are() -> None:
    with pytest.raises(InputError, match=r"Did you mean 'paper_8s'.*excite_12s, paper_8s, rotations_x"):
        find_sequence("paper8s")
    with pytest.raises(InputError, match="Unknown sequence"):
        find_sequence("nowhere.yaml")
    with pytest.raises(InputError, match="cannot be read"):
        load_sequence(Path("nowhere.yaml"))


def test_targets_beyond_the_limits_are_refused() -> None:
    sequence = parsed(TEXT)
    bounds = (math.radians(-2), math.radians(2))
    with pytest.raises(InputError) as caught:
        sequence.check_limits({"motor_x": bounds})
    assert "some moves motor_x from 1 to 3 deg; allowed are -2 to 2 deg" in str(caught.value)
    assert "Unknown channel 'motor_y'" in str(caught.value)


LINEAR = """
description: An arm on a carriage.
initial_deg: {Hip: 10}
initial_mm: {Rail: 5}
trials: 2
command:
  Rail: [{step: {to_mm: 20, lasts_s: 1}}, {sine: {amplitude: 0.001, frequency_hz: 2, lasts_s: 1}}]
  Hip: [{prbs: {amplitude_deg: 2, bit_s: 0.1, register: 5, lasts_s: 2}}]
"""


def test_linear_axes_are_given_in_mm() -> None:
    sequence = parsed(LINEAR)
    (command,) = sequence.commands
    assert dict(zip(command.channels, command.initial, strict=True)) == pytest.approx(
        {"Hip": math.radians(10), "Rail": 0.005}
    )
    assert command.reach()["Rail"] == pytest.approx((0.005, 0.021))
    with pytest.raises(InputError) as caught:
        sequence.check_limits({"Rail": (-0.01, 0.01), "Hip": (-1.0, 1.0)}, linear=("Rail",))
    assert "some moves Rail from 5 to 21 mm; allowed are -10 to 10 mm" in str(caught.value)


@pytest.mark.parametrize("text", [TEXT, LINEAR])
def test_a_sequence_that_is_written_is_read_back(text: str) -> None:
    (command,) = parsed(text).commands
    again = sequence_text(command, "of a test", 4, linear=("Rail",))
    sequence = _read(again)
    assert sequence.hash == command.hash
    assert (sequence.description, sequence.trials) == ("of a test", 4)


def _read(text: str) -> Sequence:
    return parse_sequence(parse_yaml(text, "x").data, "some", "some.yaml")


@settings(max_examples=100, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])
@given(data=st.data())
def test_a_damaged_sequence_is_read_or_refused(data: st.DataObject) -> None:
    whole = config.find("sequences", "excite_12s").read_text(encoding="utf-8")
    start = data.draw(st.integers(0, len(whole)))
    end = data.draw(st.integers(start, min(len(whole), start + 40)))
    piece = data.draw(
        st.sampled_from(["1", "null", "2020-99-99", "[]", "{}", "9" * 30, "1e300", "-", "'", "*b", "{1: 2}"])
    )
    with contextlib.suppress(InputError):  # anything else is a failure
        _read(whole[:start] + piece + whole[end:])
