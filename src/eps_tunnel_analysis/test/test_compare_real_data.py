# SPDX-License-Identifier: Apache-2.0
"""Recordings of a real servo compared with a plain model of it. They are skipped where they are absent."""

import json
from pathlib import Path

import pytest
from command_line import eps_tunnel

DATA = Path(__file__).resolve().parents[4] / "shared" / "data" / "mx106_no_load" / "motor_0"
pytestmark = pytest.mark.skipif(not DATA.is_dir(), reason="no ../shared/data beside the project")


def compared(*arguments):
    result = eps_tunnel("compare", *arguments, "--json")
    assert result.returncode == 0, result.stderr
    return json.loads(result.stdout)


@pytest.mark.parametrize("motion", ["triangle", *(pytest.param(m, marks=pytest.mark.study) for m in ("step", "sine"))])
def test_three_repeats_make_a_tunnel_that_a_plain_model_leaves(motion, tmp_path):
    content = compared("--real", DATA / motion, "--model", "horn", "--out", tmp_path / "out")
    report = (tmp_path / "out" / "report.html").read_text()
    assert "new uPlot" in report and '"joint"' in report
    assert content["trials_real"] == 3
    assert content["signals"] == ["joint"]
    shares = [a["joint"] for a in content["alikeness"]]
    assert shares == sorted(shares)
    (error,) = content["errors"]
    # The plain model follows the servo, but misses it by more than the servo misses itself.
    assert error["repeat_rms"] < error["rms"] < 0.1 * error["range"]


def test_a_repeat_of_the_real_servo_is_closer_than_a_plain_model():
    tunnel = "--real", DATA / "step" / "repeat_1", DATA / "step" / "repeat_2"
    repeat = compared(*tunnel, "--sim", DATA / "step" / "repeat_3")
    model = compared(*tunnel, "--model", "horn")
    assert repeat["errors"][0]["rms"] < model["errors"][0]["rms"] / 2
    for a, b in zip(repeat["alikeness"], model["alikeness"], strict=True):
        assert a["joint"] > b["joint"]
