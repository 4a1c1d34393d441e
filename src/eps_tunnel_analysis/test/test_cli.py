# SPDX-License-Identifier: Apache-2.0
"""The command line as a user meets it, on real bags."""

import csv
import json
import re
import signal
import subprocess
import time

import numpy as np
import pytest
import recording_cases
from bag_files import (
    SECONDS,
    START,
    STEP,
    command,
    grid,
    response,
)
from command_line import COMMAND, ENVIRONMENT, eps_tunnel, process, refused

from eps_tunnel_analysis.recording import BagWriter, read
from eps_tunnel_analysis.recording.decode import BALL_STATE, JOINT_STATE


def test_a_comparison_of_bags_writes_report_tables_and_pictures(bags, tmp_path):
    result = process("compare", "--real", bags / "real", "--sim", bags / "sim", "--out", tmp_path / "out")
    assert result.returncode == 0, result.stderr
    assert str(tmp_path / "out" / "report.html") in result.stdout
    assert "k = 5" in result.stdout
    assert "moving, upwards" in result.stdout
    assert {p.name for p in (tmp_path / "out").iterdir()} == {
        "report.html", "compare.json", "alikeness.csv", "errors.csv", "where.csv", "spans.csv", "tunnel.csv",
        "tunnel_servo.svg", "tunnel_servo.png", "alikeness_over_k.svg", "alikeness_over_k.png",
    }  # fmt: skip
    assert [p.name for p in tmp_path.iterdir()] == ["out"]  # nothing partial stays behind
    with (tmp_path / "out" / "tunnel.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    mean = np.array([float(row["servo_mean"]) for row in rows])
    noise = np.mean([0.001 * i * np.sin(40 * grid()) for i in range(3)], axis=0)
    assert np.allclose(mean, response(grid()) + noise, atol=1e-9)


def test_json_is_all_that_stdout_gets_and_equals_the_file(bags, tmp_path):
    result = eps_tunnel(
        "compare", "--real", bags / "real", "--sim", bags / "sim", "--json", "--k", 2, 1, "--out", tmp_path / "out"
    )
    content = json.loads(result.stdout)
    assert content == json.loads((tmp_path / "out" / "compare.json").read_text())
    assert [a["k"] for a in content["alikeness"]] == [1, 2]
    assert 0 < content["alikeness"][0]["joint"] < content["alikeness"][1]["joint"] < 1
    error = response(grid(), 0.08) - response(grid())  # but for the mean of the noise
    assert content["errors"][0]["rms"] == pytest.approx(np.sqrt(np.mean(error**2)), rel=0.02)


def test_reality_compared_with_itself_is_alike_everywhere(bags):
    result = eps_tunnel("compare", "--real", bags / "real", "--sim", bags / "real", "--json")
    assert all(a["joint"] == 1 for a in json.loads(result.stdout)["alikeness"])


def test_help_and_version_of_every_command():
    top = process("--help")
    assert top.returncode == 0
    assert "compare" in top.stdout
    assert "effects" in top.stdout
    assert eps_tunnel("--version").stdout.startswith("eps-tunnel ")
    for name in re.findall(r"^    (\w[\w-]*)  ", top.stdout, flags=re.MULTILINE):
        assert eps_tunnel(name, "--help").returncode == 0


def test_effects_are_listed_and_told():
    listed = json.loads(eps_tunnel("effects", "--json").stdout)
    assert {"backlash", "command_delay"} <= {e["name"] for e in listed}
    assert listed[0]["name"] in eps_tunnel("effects").stdout
    assert "Mistaken for" in eps_tunnel("effects", "backlash").stdout
    refused("effects", "backlashh", told=["Did you mean 'backlash'?"], call=process)


def test_a_damaged_bag_is_repaired_into_a_new_one(bags, tmp_path):
    damaged = tmp_path / "damaged"
    with BagWriter(damaged) as writer:
        writer.add_topic("/real/joint_states", JOINT_STATE)
        for i in range(200):
            at = START + i * STEP
            writer.write("/real/joint_states", at, recording_cases.joints(at, ["servo"], [0.001 * i]))
            if i == 99:
                writer.flush()
                flushed = next(damaged.glob("*.mcap")).stat().st_size
    file = next(damaged.glob("*.mcap"))
    file.write_bytes(file.read_bytes()[: flushed + 300])
    told = refused("compare", "--real", damaged, "--sim", bags / "sim", told=["eps-tunnel repair"])
    assert str(damaged) in told
    result = eps_tunnel("repair", damaged, "--out", tmp_path / "whole")
    assert result.returncode == 0, result.stderr
    saved = len(read(tmp_path / "whole").topics["/real/joint_states"])
    assert 100 <= saved < 200
    assert f"{saved} messages saved" in result.stdout
    sound = eps_tunnel("repair", bags / "sim", "--out", tmp_path / "copy")
    assert sound.returncode == 0, sound.stderr
    assert "The bag was complete" in sound.stdout
    assert eps_tunnel("compare", "--real", bags / "real", "--sim", tmp_path / "copy").returncode == 0
    refused("repair", bags / "sim", "--out", tmp_path / "copy", told=[tmp_path / "copy", "exists"])


def test_a_camera_that_recorded_nothing_is_left_out(bags, tmp_path):
    with BagWriter(tmp_path / "real") as writer:
        writer.add_topic("/real/joint_states", JOINT_STATE)
        writer.add_topic("/real/ball", BALL_STATE)
        for i in range(round(SECONDS * 100) + 1):
            at = START + i * STEP
            writer.write("/real/joint_states", at, recording_cases.joints(at, ["servo"], [0.001 * i]))
    result = eps_tunnel("compare", "--real", tmp_path / "real", "--sim", bags / "sim", "--json")
    assert result.returncode == 0, result.stderr
    assert json.loads(result.stdout)["signals"] == ["servo"]
    refused("compare", "--real", tmp_path / "real", "--sim", bags / "sim", "--signals", "ball_x", told=["/real/ball"])


def test_a_table_is_imported_and_compared(bags, tmp_path):
    rows = [f"{t:.2f},{c:.6f},{v:.6f}" for t, c, v in zip(grid(), command(grid()), response(grid()), strict=True)]
    (tmp_path / "log.csv").write_text("\n".join(["t,goal,angle", *rows]) + "\n")
    columns = ("--time", "t", "--command", "servo=goal", "--position", "servo=angle")
    result = eps_tunnel("import-csv", tmp_path / "log.csv", *columns, "--out", tmp_path / "bag")
    assert result.returncode == 0, result.stderr
    content = json.loads(eps_tunnel("compare", "--real", tmp_path / "bag", "--sim", bags / "sim", "--json").stdout)
    assert content["signals"] == ["servo"]
    wrong = ("--time", "time", *columns[2:])
    refused(
        "import-csv", tmp_path / "log.csv", *wrong, "--out", tmp_path / "no", told=["log.csv", "column 'time'", "goal"]
    )
    refused("import-csv", tmp_path / "log.csv", *columns, "--out", tmp_path / "bag", told=[tmp_path / "bag", "exists"])
    refused("import-csv", tmp_path / "log.csv", "--time", "t", "--position", "angle", "--out", tmp_path / "no",
            told=["JOINT=COLUMN"])  # fmt: skip


@pytest.mark.realtime
def test_ctrl_c_ends_with_130_and_leaves_nothing_behind(bags, tmp_path):
    process = subprocess.Popen(
        [*COMMAND, "compare", "--real", bags / "real", "--sim", bags / "sim", "--rate", "20000", "--out",
         tmp_path / "out"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=ENVIRONMENT,
    )  # fmt: skip
    deadline = time.monotonic() + 60
    while not list(tmp_path.iterdir()) and process.poll() is None and time.monotonic() < deadline:
        time.sleep(0.01)  # until it writes into its folder
    process.send_signal(signal.SIGINT)
    _, stderr = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "interrupted" in stderr
    assert "Traceback" not in stderr
    assert list(tmp_path.iterdir()) == []
