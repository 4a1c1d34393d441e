# SPDX-License-Identifier: Apache-2.0
"""What a change of a value would do, on plays of known origin."""

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import eps_tunnel, refused
from fit_cases import TRUTH, bag_of, made_by, plays, start, step

from eps_tunnel_analysis.calibration.calibrate import judge
from eps_tunnel_analysis.compare import compare
from eps_tunnel_analysis.recorded_play import Play
from eps_tunnel_analysis.report.values_pictures import sweep_picture
from eps_tunnel_analysis.simulated import roll_out
from eps_tunnel_analysis.values.sweep import sweep
from labyrinth_sim.errors import InputError

SIGNALS = ("motor_x",)
RIGHT = {name: TRUTH[name] for name in TRUTH}


def test_each_point_says_what_compare_says_of_a_model_with_that_value() -> None:
    model, (play,) = start().with_values(RIGHT), plays((3.0,))
    swept = sweep(model, [play], ["drive.x.p=12:24:3"], ks=(1.0, 3.0))
    for i, p in enumerate((12.0, 18.0, 24.0)):
        changed = model.with_values({"drive.x.p": p})
        shown = compare(play.trials, roll_out(changed, play), (1.0, 3.0), signals=swept.signals)
        assert swept.errors[i] == pytest.approx([e.command_error for e in shown.errors], rel=1e-12)
        assert swept.alikeness[i].tolist() == [list(a.shares.values()) for a in shown.alikeness]
        assert swept.joint[i].tolist() == [a.joint for a in shown.alikeness]
        assert swept.itself == tuple(a.joint for a in shown.against_itself)


def test_the_rig_against_itself_stands_beside_the_alikeness(tmp_path: Path) -> None:
    (play,) = plays((3.0,))
    for i in range(3):
        one = replace(play.trials, values=play.trials.values[[i]], commands=play.trials.commands[[i]])
        bag_of(tmp_path / f"bag{i}", one)
    told = eps_tunnel("sweep", "drive.x.p=12:24:3", "--real", tmp_path, "--model", "labyrinth", "--k", 1)
    assert told.stdout.count("rig against itself") == 1
    for asked in (["drive.x.p=12:24:3"], ["drive.x.p=12:24:2", "drive.x.delay=0.01:0.03:2"]):
        swept = sweep(start().with_values(RIGHT), [play], asked, ks=(1.0,))
        (best,) = swept.to_json()["most_alike"]
        assert best["rig_against_itself"] == swept.itself[0] and 0 < swept.itself[0] < 1
        header, rows = swept.rows()
        assert {row[header.index("alikeness_jointly_k1_rig")] for row in rows} == {swept.itself[0]}
        above = sweep_picture(swept).axes[0]
        words = [above.get_title(), *above.get_legend_handles_labels()[1]]
        assert any("against itself" in text for text in words)
        alone = sweep(start().with_values(RIGHT), plays((3.0,), trials=1), asked, ks=(1.0,))
        assert np.isnan(alone.itself[0])
        above = sweep_picture(alone).axes[0]
        assert not any("itself" in text for text in (above.get_title(), *above.get_legend_handles_labels()[1]))


def test_several_plays_count_as_judge_counts_them() -> None:
    model, several = start().with_values(RIGHT), plays((3.0, -2.0))
    swept = sweep(model, several, ["drive.x.delay=0.01:0.03:2"], signals=SIGNALS)
    for i, delay in enumerate((0.01, 0.03)):
        (score,) = judge(model.with_values({"drive.x.delay": delay}), several, SIGNALS)
        assert swept.errors[i, 0] == pytest.approx(score.error)
        assert dict(zip(swept.ks, swept.alikeness[i, :, 0].tolist(), strict=True)) == pytest.approx(score.alikeness)


def test_the_least_error_lies_at_the_value_that_made_the_data() -> None:
    swept = sweep(start().with_values({**RIGHT, "drive.x.p": 15.0}), plays((3.0,)), ["drive.x.p"], signals=SIGNALS)
    assert (swept.values[0].points[0], swept.values[0].points[-1]) == (7.5, 25.0)  # twice 15 is out of bounds
    assert 15.0 in swept.values[0].points, "the model's own value is one of the points"
    at, _ = swept.best(swept.mean_error, largest=False)
    assert at["drive.x.p"] == pytest.approx(18.0, abs=0.6)


def test_a_pair_is_a_map_whose_first_value_is_the_first_index() -> None:
    asked = ["drive.x.p=14:22:3", "drive.x.delay=0.012:0.042:4"]
    swept = sweep(start().with_values(RIGHT), plays((3.0,)), asked, signals=SIGNALS)
    assert swept.joint.shape == (3, 4, 5)
    at, _ = swept.best(swept.mean_error, largest=False)
    assert at == pytest.approx({"drive.x.p": 18.0, "drive.x.delay": 0.032})
    header, rows = swept.rows()
    assert header[:3] == ("drive.x.p", "drive.x.delay", "error_motor_x")
    assert len(rows) == 12 and rows[1][:2] == pytest.approx((14.0, 0.022))


def test_an_effect_that_the_model_lacks_is_swept_from_off() -> None:
    real = start().with_values(RIGHT).with_effect("backlash", "x", {"width": 0.01})
    recorded = [Play("", made_by(real, step(4.0)))]
    swept = sweep(start().with_values(RIGHT), recorded, ["backlash.x.width=0:0.02:5"])
    assert swept.values[0].given == 0.0
    assert swept.best(swept.mean_error, largest=False)[0]["backlash.x.width"] == pytest.approx(0.01)
    assert "no backlash.x" in swept.notes[0]


def test_what_was_not_seen_is_left_out_and_what_diverges_is_no_error_of_zero() -> None:
    (play,) = plays((3.0,))
    values = play.trials.values.copy()
    values[:, 20:30, 0] = np.nan
    partly = replace(play, trials=replace(play.trials, values=values))
    swept = sweep(start().with_values(RIGHT), [partly], ["drive.x.p=17:18:2"], signals=SIGNALS)
    assert np.isfinite(swept.errors).all() and swept.joint[1, -1] > 0.9


@pytest.mark.parametrize(
    ("asked", "complaint"),
    [
        (["drive.x.q"], "Did you mean 'drive.x"),
        (["drive.x.p=5"], "expected drive.x.p=LOW:HIGH"),
        (["drive.x.p=5:4"], "LOW below HIGH"),
        (["drive.x.p=1:1e9"], "both within"),
        (["drive.x.p=nan:5"], "both within"),
        (["drive.x.p=1:5:1"], "at least 2 points"),
        (["drive.x.p=1:5:300", "drive.x.d=0:1:300"], "at most 20000"),
        (["drive.x.p", "drive.x.p"], "named twice"),
        (["drive.x.p", "drive.x.d", "drive.x.i"], "one value or two"),
    ],
)
def test_what_cannot_be_swept_is_refused_with_words(asked, complaint) -> None:
    with pytest.raises(InputError, match=complaint):
        sweep(start(), plays((3.0,)), asked)


def test_the_command_writes_picture_table_and_json(tmp_path) -> None:
    bag_of(tmp_path / "bag", plays((3.0,), trials=1)[0].trials)
    call = ["--real", tmp_path / "bag", "--model", "labyrinth", "--out", tmp_path / "out"]
    result = eps_tunnel("sweep", "drive.x.p=1:20:4", *call)
    assert result.returncode == 0, result.stderr
    assert "least error E" in result.stdout
    assert {p.name for p in (tmp_path / "out").iterdir()} == {"sweep.svg", "sweep.csv", "sweep.json"}
    with (tmp_path / "out" / "sweep.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    told = json.loads((tmp_path / "out" / "sweep.json").read_text())
    assert [float(r["drive.x.p"]) for r in rows] == told["values"][0]["points"]
    assert [float(r["error_motor_x"]) for r in rows] == [e[told["signals"].index("motor_x")] for e in told["errors"]]
    svg = (tmp_path / "out" / "sweep.svg").read_text()
    assert "<svg" in svg
    refused("sweep", "drive.x.p", *call, told=["exists already"])
    pair = eps_tunnel("sweep", "drive.x.p=1:20:2", "drive.x.d=0:1:2", *call[:-1], tmp_path / "pair")
    assert pair.returncode == 0, pair.stderr
    assert (tmp_path / "pair" / "sweep.svg").stat().st_size > 5000
