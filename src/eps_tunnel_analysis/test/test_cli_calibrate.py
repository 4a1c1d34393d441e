# SPDX-License-Identifier: Apache-2.0
"""`eps-tunnel calibrate` as a user meets it: real processes, bags, files."""

import json
import signal
import subprocess
from pathlib import Path

import pytest
from command_line import COMMAND, ENVIRONMENT, eps_tunnel, process
from fit_cases import TRUTH, bag_of, plays

from eps_tunnel_analysis.cli.main import main
from eps_tunnel_analysis.processes import INTERRUPTED
from eps_tunnel_analysis.tasks import CalibrateTask, run_task
from labyrinth_sim.model import load_model

CALIBRATE = [*COMMAND, "calibrate"]


@pytest.fixture(scope="module")
def bags(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("bags")
    for number, play in enumerate(plays(trials=1)):
        bag_of(folder / f"bag{number}", play.trials)
    return folder


def call(bags, out, *options):
    arguments = ["--real", bags, "--model", "labyrinth", "--out", out, *options]
    return process("calibrate", *arguments)


def test_a_calibration_writes_a_model_that_loads_and_tells_where_its_values_come_from(bags, tmp_path) -> None:
    result = call(bags, tmp_path / "mine", "--free", "drive.x.[pd]", "drive.x.delay", "--signals", "motor_x")
    assert result.returncode == 0, result.stderr
    assert "Held-out commands" in result.stdout
    assert "best" in result.stderr
    model = load_model(tmp_path / "mine.yaml")
    for name in ("p", "delay"):
        found = model.drives["x"].values[name]
        assert found.value == pytest.approx(TRUTH[f"drive.x.{name}"], rel=0.1)
        assert found.source.startswith("calibrate: gauss-newton on error, seed 0, 5 bags, ")
        assert "held-out error" in found.source
    assert model.drives["y"].values["p"].source.startswith("paper"), "what was not fitted keeps its source"
    assert len(model.provenance["bags"]) == 5
    told = json.loads((tmp_path / "mine.fit.json").read_text())
    assert told["values"]["drive.x.p"] == model.drives["x"].values["p"].value
    assert {b["sha256"] for b in told["bags"]} == {b["sha256"] for b in model.provenance["bags"]}
    fit = told["fits"][0]
    assert fit["parameters"][0]["half_width"] > 0
    assert len(fit["held_out_plays"]) == 1
    assert fit["held_out_after"] < fit["held_out_before"]
    assert told["versions"]["mujoco"]


def refused(capsys, bags, out, *options) -> str:
    """Calls in this process; gives what is told on stderr."""
    assert main(["calibrate", *map(str, ["--real", bags, "--model", "labyrinth", "--out", out, *options])]) == 2
    told = capsys.readouterr()
    assert not told.out
    return told.err


def test_nothing_is_overwritten(bags, tmp_path, capsys) -> None:
    (tmp_path / "mine.fit.json").write_text("precious")
    assert "never overwritten" in refused(capsys, bags, tmp_path / "mine.yaml")
    assert (tmp_path / "mine.fit.json").read_text() == "precious"


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (["--free", "drive.z.*"], "Unknown parameter 'drive.z.*'"),
        (["--hold-out", "5"], "Cannot hold out 5 of 5"),
        (["--generations", "3"], "--generations is for --method es"),
        (["--signals", "motor_q"], "motor_q"),
        (["--scheduler", "nonsense"], "--scheduler"),
    ],
)
def test_bad_input_is_told_and_leaves_no_file(bags, tmp_path, capsys, options, told) -> None:
    assert told in refused(capsys, bags, tmp_path / "mine.yaml", *options)
    assert not list(tmp_path.iterdir())


@pytest.mark.study
@pytest.mark.realtime
def test_ctrl_c_keeps_the_best_so_far_and_the_checkpoint_goes_on_from_there(bags, tmp_path) -> None:
    options = ["--method", "es", "--generations", "6", "--signals", "motor_x", "--free", "drive.x.p", "drive.x.delay",
               "--hold-out", "3", "--progress", "lines", "--json"]  # fmt: skip
    given = ["--real", bags, "--model", "labyrinth", *options]
    whole = eps_tunnel("calibrate", *given, "--out", tmp_path / "whole")
    assert whole.returncode == 0, whole.stderr
    arguments = [*given, "--checkpoint", tmp_path / "checkpoint"]
    running = subprocess.Popen(
        [*CALIBRATE, *map(str, [*arguments, "--out", tmp_path / "cut"])],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=ENVIRONMENT,
    )  # fmt: skip
    for line in running.stderr:
        if json.loads(line)["evaluations"] > 100:
            running.send_signal(signal.SIGINT)
            break
    stdout, stderr = running.communicate(timeout=120)
    assert running.returncode == 130, stderr
    cut = json.loads(stdout)
    assert cut["interrupted"]
    assert cut["evaluations"] < json.loads(whole.stdout)["evaluations"]
    assert load_model(tmp_path / "cut.yaml").values()["drive.x.p"] == cut["values"]["drive.x.p"]
    resumed = eps_tunnel("calibrate", *arguments, "--out", tmp_path / "resumed")
    assert resumed.returncode == 0, resumed.stderr
    first, second = json.loads(whole.stdout), json.loads(resumed.stdout)
    assert second["values"] == first["values"]
    assert second["fits"][0]["history"] == first["fits"][0]["history"]


def test_a_calibration_in_a_process_tells_its_progress_and_can_be_called_off(bags, tmp_path) -> None:
    progress = []
    task = CalibrateTask(
        bags=(bags,), model="labyrinth", out=tmp_path / "mine", method="es", free=("drive.x.p",), signals=("motor_x",)
    )
    ended = run_task(task, progress.append, lambda: any(p["evaluations"] > 1 for p in progress))
    assert ended.code == INTERRUPTED
    assert ended.content["interrupted"]
    assert 0 < progress[-1]["evaluations"] / progress[-1]["of"] < 1
    assert load_model(tmp_path / "mine.yaml").values()["drive.x.p"] == ended.content["values"]["drive.x.p"]
    refused = run_task(task, progress.append, lambda: False)
    assert refused.content is None
    assert "never overwritten" in refused.complaint
