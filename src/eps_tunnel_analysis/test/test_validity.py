# SPDX-License-Identifier: Apache-2.0
"""A model tells where it was shown to hold, and a comparison where a play leaves that."""

import json
from dataclasses import replace

import numpy as np
import pytest
from bag_files import START
from command_line import eps_tunnel
from fit_cases import TRUTH, bag_of, made_by, plays, start, step

from eps_tunnel_analysis.calibration.calibrate import judge
from eps_tunnel_analysis.calibration.validity import begun_at, validity_of
from eps_tunnel_analysis.recorded_play import Play
from eps_tunnel_analysis.simulated import roll_out
from eps_tunnel_analysis.valid import beyond
from labyrinth_sim.model import Model, load_model


def right() -> Model:
    return start().with_values(TRUTH)


def with_region(*degrees: float) -> Model:
    return replace(right(), valid=validity_of(right(), plays(degrees), [], []))


def notes_of(model: Model, degrees: float) -> tuple[str, ...]:
    (play,) = plays((degrees,))
    return beyond(model, play.trials, roll_out(model, play))


def test_the_region_is_what_the_recordings_went_through_with_the_error_on_what_was_held_out() -> None:
    fitted, held = plays((3.0,)), plays((-2.0,))
    valid = validity_of(right(), fitted, held, [])
    assert valid is not None
    motor, other = valid.signals["motor_x"], valid.signals["motor_y"]
    assert (motor.low, motor.high) == pytest.approx(np.radians([-2.0, 3.0]), abs=np.radians(0.25))
    # P drives the step of 3 deg at up to 18/s times 3 deg, less what it goes in the 50 ms over which speed is taken.
    assert motor.speed is not None and 0.5 * 18 * np.radians(3) < motor.speed < 18 * np.radians(3)
    assert other.high < np.radians(0.1)
    scores = {s.signal: s.error for s in judge(right(), held)}
    assert motor.error == scores["motor_x"] and valid.held_out == ("-2deg",)
    assert valid.signals["motor_x_effort"].high > 0.0 and valid.signals["motor_x_effort"].error is None


def test_a_play_within_the_region_is_not_remarked_on() -> None:
    assert notes_of(with_region(3.0, -3.0), 2.0) == ()
    assert notes_of(right(), 5.0) == (), "nothing is known of a model without a region"


def test_a_play_that_goes_further_or_faster_is() -> None:
    far = notes_of(with_region(2.0, -2.0), 4.0)
    assert any("motor_x goes from" in t and "validated from" in t and "moves at up to" in t for t in far), far
    assert any("motor_x_effort" in text for text in far), "the load, too"
    fast = right().with_values({"drive.x.p": 25.0})
    quick = Play("", made_by(fast, step(2.0)))
    told = beyond(with_region(2.0, -2.0), quick.trials, roll_out(right(), quick))
    assert any("motor_x moves at up to" in text for text in told), told


def test_the_date_is_that_of_the_metadata_else_of_the_first_message_else_unknown(tmp_path) -> None:
    bag = bag_of(tmp_path / "bag", plays((2.0,), trials=1)[0].trials)
    assert begun_at(bag) == "2023-11-14 22:13 UTC"
    metadata = bag / "metadata.yaml"
    text = metadata.read_text()
    for said in ("nanoseconds_since_epoch: 1000000000", "nanoseconds_since_epoch: 99999999999999999999999999"):
        metadata.write_text(text.replace(f"nanoseconds_since_epoch: {START}", said))
        assert begun_at(bag) is None, "a clock that began with the machine, and one that says nothing"
    metadata.unlink()
    assert begun_at(bag) == "2023-11-14 22:13 UTC"
    assert begun_at(tmp_path / "nothing") is None


def test_calibrate_writes_the_region_and_compare_says_where_a_play_leaves_it(tmp_path) -> None:
    for name, degrees in (("small", 2.0), ("large", 5.0)):
        bag_of(tmp_path / name, plays((degrees,), trials=1)[0].trials)
    out = tmp_path / "mine.yaml"
    done = eps_tunnel("calibrate", "--real", tmp_path / "small", "--model", "labyrinth", "--out", out, "--free",
                      "drive.x.p", "--budget", 4, "--progress", "none")  # fmt: skip
    assert done.returncode == 0, done.stderr
    valid = load_model(out).valid
    assert valid is not None and valid.signals["motor_x"].high < np.radians(2.3)
    assert valid.recordings[0].startswith(f"{tmp_path / 'small'} ")
    assert valid.recordings[0].endswith(" 2023-11-14 22:13 UTC"), "1.7e9 s, when the bag began"
    for name, remarked in (("small", False), ("large", True)):
        result = eps_tunnel("compare", "--real", tmp_path / name, "--model", out, "--json")
        assert result.returncode == 0, result.stderr
        assert any("Outside the validated range" in note for note in json.loads(result.stdout)["notes"]) == remarked
