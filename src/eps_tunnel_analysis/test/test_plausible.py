# SPDX-License-Identifier: Apache-2.0
"""Stray samples and degrees taken for radians are said, wherever a recording is used; nothing else is."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from bag_files import command, grid, joint_states, response, servo_bag
from command_line import eps_tunnel
from hypothesis import given
from hypothesis import strategies as st

from eps_tunnel_analysis.inputs import load_recorded
from eps_tunnel_analysis.recording.plausible import FAR, SHORT, Samples, doubts, stray

DEGREES = 180 / math.pi
TIME = np.arange(200) / 100


def channel(values: np.ndarray, **options) -> Samples:
    return Samples("command 'motor_x'", "rad", "trial", TIME[: len(values)], values, **options)


@given(st.sets(st.integers(0, 199), min_size=1, max_size=3), st.sampled_from([-1.0, 1.0]), st.floats(1.1, 1e9))
def test_stray_samples_are_found_and_no_others(at: set[int], sign: float, far: float) -> None:
    values = 0.1 * np.sin(8 * TIME)
    assert not len(stray(values))
    values[list(at)] += sign * far * (FAR + 1) * 0.2
    assert set(stray(values)) == at


def test_steps_ticks_and_signals_at_rest_are_not_stray() -> None:
    step = np.where(TIME > 1.0, 0.3, 0.0)
    tick = np.zeros(200)
    tick[100] = 0.0052
    burst = np.zeros(200)
    burst[50 : 50 + SHORT + 1] = 5.0
    for values in (step, tick, burst, np.zeros(200), np.array([0.0, 1e6])):
        assert not len(stray(values))


def test_targets_beyond_the_limits_are_said_and_degrees_guessed() -> None:
    inside = channel(0.1 * np.sin(8 * TIME), limits=(-0.14, 0.14), commanded=True)
    assert doubts([inside]) == []
    (said,) = doubts([inside, channel(0.1 * DEGREES * np.sin(8 * TIME), limits=(-0.14, 0.14), commanded=True)])
    assert "beyond the rig's limits, -0.14 to 0.14 rad" in said and "degrees, taken for rad?" in said
    (said,) = doubts([channel(40 * np.sin(8 * TIME), limits=(-0.14, 0.14), commanded=True)])
    assert "as far as -40 rad (-2292 deg)" in said and "degrees, taken" not in said


def test_without_limits_more_than_a_turn_is_asked_about() -> None:
    assert doubts([channel(6.2 * np.sin(8 * TIME), commanded=True)]) == []
    (said,) = doubts([channel(30 * np.sin(8 * TIME), commanded=True)], cure=" Then say --degrees.")
    assert "beyond a whole turn" in said and said.endswith("taken for rad? Then say --degrees.")
    assert doubts([channel(30 * np.sin(8 * TIME))]) == [], "a wheel may turn; only what was asked for has limits"


@pytest.fixture(scope="module")
def odd(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of a servo: one sample of 1e6 rad in the bag `spike`, everything in degrees in the bag `degrees`."""
    folder = tmp_path_factory.mktemp("odd")
    spiked = response(grid())
    spiked[70] = 1e6
    servo_bag(folder / "spike", states=joint_states(spiked))
    degrees = [joint_states(DEGREES * values, "joint") for values in (5 * command(grid()), 5 * response(grid()))]
    servo_bag(folder / "degrees", commands=degrees[0], states=degrees[1])
    servo_bag(folder / "sim", side="/sim")
    return folder


def test_compare_says_so_on_the_terminal_in_the_json_and_on_the_page(odd: Path, tmp_path: Path) -> None:
    result = eps_tunnel("compare", "--real", odd / "spike", "--sim", odd / "sim", "--out", tmp_path / "gap")
    assert result.returncode == 0, result.stderr
    said = "signal 'servo' has 1 stray sample, 10^6 rad at 0.70 s of"
    assert f"Warning: {said}" in result.stdout
    assert any(said in note for note in json.loads((tmp_path / "gap" / "compare.json").read_text())["notes"])
    assert "1 stray sample, 10^6 rad" in (tmp_path / "gap" / "report.html").read_text()
    clean = eps_tunnel("compare", "--real", odd / "sim", "--sim", odd / "sim")
    assert "Warning" not in clean.stdout + clean.stderr


def test_a_rigs_limits_hold_wherever_plays_are_read(odd: Path) -> None:
    recorded = load_recorded("horn", [odd / "degrees"])
    (said,) = recorded.notes
    assert said.startswith("Warning: command 'joint' lies beyond the rig's limits, -3.2 to 3.2 rad, in 34")
    assert "(1641 deg). As degrees they would fit" in said


def test_import_csv_says_so(tmp_path: Path) -> None:
    rows = "".join(f"{t},{DEGREES * 5 * u},{DEGREES * 5 * y}\n" for t, u, y in zip(
        grid(), command(grid()), response(grid()), strict=True))  # fmt: skip
    (tmp_path / "log.csv").write_text("t,goal,angle\n" + rows)
    words = ("import-csv", tmp_path / "log.csv", "--time", "t", "--command", "servo=goal", "--position", "servo=angle")
    result = eps_tunnel(*words, "--out", tmp_path / "bag")
    assert result.returncode == 0
    assert "Warning: command 'servo' lies beyond a whole turn" in result.stderr and "--degrees" in result.stderr
    assert result.stdout == f"{tmp_path / 'bag'}\n"
    right = eps_tunnel(*words, "--degrees", "--out", tmp_path / "right")
    assert (right.returncode, right.stderr) == (0, "")
