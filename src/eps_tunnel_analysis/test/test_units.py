# SPDX-License-Identifier: Apache-2.0
"""Recordings in other units than SI, and recordings at several settings: from the file to values that are compared."""

import json
from pathlib import Path

import numpy as np
import pytest
import yaml
from command_line import eps_tunnel
from small_recordings import record, write_rig

from eps_tunnel_analysis.calibration.calibrate import Settings, calibrate
from eps_tunnel_analysis.fit.problem import default_free
from eps_tunnel_analysis.inputs import Reading, known_of, load_recorded, load_sides
from eps_tunnel_analysis.recording import CsvColumns, csv_to_bag
from labyrinth_sim.errors import InputError
from labyrinth_sim.model import load_model, save_model

TICK = 2 * np.pi / 4096


def test_ticks_and_currents_become_angles_and_torques(tmp_path: Path) -> None:
    ticks = {"unit": "ticks", "ticks_per_turn": 4096, "zero": 2048}
    stated = {"unit": "mA", "torque_constant": 1.5}
    model = load_model(write_rig(tmp_path, command=ticks, position=ticks, effort=stated))
    bag = record(model, tmp_path / "bag", TICK, 2048, 1.5e-3)
    sides = load_sides([bag], model=str(model.path), reading=Reading(signals=("arm", "arm_effort")))
    assert sides.real.units == ("rad", "N m")
    assert sides.real.values == pytest.approx(sides.sim.values, abs=2e-3)
    assert np.ptp(sides.real.commands) == pytest.approx(0.6, abs=0.02)
    stamped = load_recorded(str(model.path), [bag]).plays[0].stamped[0]
    assert np.abs(stamped.signals["arm"].values).max() < 0.5, "also at their own stamps"


def test_a_simulation_on_its_own_topics_is_si(tmp_path: Path) -> None:
    ticks = {"unit": "ticks", "ticks_per_turn": 4096, "zero": 2048}
    model = load_model(write_rig(tmp_path, command=ticks, position=ticks))
    bag = record(model, tmp_path / "bag", TICK, 2048)
    table = tmp_path / "sim.csv"
    np.savetxt(table, np.column_stack([np.arange(300) * 0.01, np.zeros(300), np.full(300, 0.1)]), delimiter=",",
               header="t,u,q", comments="")  # fmt: skip
    sim = tmp_path / "sim"
    csv_to_bag(table, CsvColumns("t", {"arm": "u"}, {"arm": "q"}), sim, "/sim")
    sides = load_sides([bag], [sim], model=None, reading=Reading(rig=str(tmp_path / "rig.yaml"), signals=("arm",)))
    assert sides.sim.values == pytest.approx(0.1) and np.abs(sides.real.values).max() < 0.5


def test_an_open_torque_constant_is_guessed_then_fitted(tmp_path: Path) -> None:
    model = load_model(write_rig(tmp_path, effort={"unit": "A"}))
    bag = record(model, tmp_path / "bag", effort=-0.7)
    name = "effort.arm_effort.torque_constant"
    start = tmp_path / "start.yaml"
    save_model(model.with_values({"drive.a.stiffness": 6.0}), start)
    recorded = load_recorded(str(start), [bag], Reading(signals=("arm", "arm_effort")))
    assert any(name in note and "guessed" in note for note in recorded.notes)
    assert recorded.plays[0].trials.units == ("rad", "A")
    free = default_free(recorded.model, signals=("arm_effort",))
    assert name in free and name not in default_free(recorded.model)
    signals = ("arm", "arm_effort")
    fit = calibrate(recorded.model, ("drive.a.stiffness", name), recorded.plays, Settings(signals=signals, nthread=1))
    assert fit.values == pytest.approx({"drive.a.stiffness": 8.0, name: -0.7}, rel=2e-2)
    saved = save_model(recorded.model.with_values(fit.values), tmp_path / "fitted.yaml")
    again = load_model(saved)
    assert again.values()[name] == pytest.approx(fit.values[name]) and again.open_scales == ()


def test_a_sledge_is_told_in_mm(tmp_path: Path) -> None:
    mm = {"unit": "mm"}
    model = load_model(write_rig(tmp_path, slides=True, command=mm, position=mm))
    bag = record(model, tmp_path / "bag", 1e-3)
    text = eps_tunnel("compare", "--real", bag, "--model", model.path).stdout
    assert " mm" in text and "deg" not in text
    fitted = eps_tunnel("calibrate", "--real", bag, "--model", model.path, "--out", tmp_path / "f.yaml", "--budget", 3,
                        "--progress", "none", "--threads", 1).stdout  # fmt: skip
    assert "N/m" in fitted and " rad" not in fitted and " mm" in fitted


def test_known_values_stand_beside_the_bag_or_in_the_call(tmp_path: Path) -> None:
    model = load_model(write_rig(tmp_path))
    for stiffness in (8.0, 4.0):
        folder = tmp_path / "bags" / f"k_{stiffness:g}"
        folder.mkdir(parents=True)
        record(model.with_values({"drive.a.stiffness": stiffness}), folder / "run")
        (folder / "known.yaml").write_text(f"drive.a.stiffness: {stiffness}\n")
    bags = tmp_path / "bags"
    one, other = (bags / f"k_{k}" / "run" for k in (8, 4))
    assert known_of([one, other], []) == {one: {"drive.a.stiffness": 8.0}, other: {"drive.a.stiffness": 4.0}}
    assert known_of([one], ["*k_8*:drive.a.stiffness=5"]) == {one: {"drive.a.stiffness": 5.0}}
    for bag in (one, other):
        content = json.loads(eps_tunnel("compare", "--real", bag, "--model", model.path, "--json").stdout)
        assert content["errors"][0]["rms"] < 1e-4, "each with its own value"
    wrong = eps_tunnel("compare", "--real", bags, "--model", model.path)
    assert wrong.returncode == 2 and "Different values are known of these bags" in wrong.stderr
    called = eps_tunnel("compare", "--real", other, "--model", model.path, "--known", "*:drive.a.stiffness=8", "--json")
    assert json.loads(called.stdout)["errors"][0]["rms"] > 1e-3, "what the call says counts first"
    (one.parent / "known.yaml").write_text("drive.a.stiffness: soft\n")
    assert "expected a number" in eps_tunnel("compare", "--real", one, "--model", model.path).stderr


def test_calibrate_holds_out_recordings_by_name(tmp_path: Path) -> None:
    model = load_model(write_rig(tmp_path))
    bags = [record(model, tmp_path / name, seed=i) for i, name in enumerate(("one", "two"))]
    told = eps_tunnel("calibrate", "--real", bags[0], "--held-out", bags[1], "--model", model.path, "--budget", 3,
               "--json", "--out", tmp_path / "f.yaml", "--progress", "none", "--threads", 1)  # fmt: skip
    content = json.loads(told.stdout)
    assert len(content["plays"]) == 2 and content["scores"]["held_out_after"]
    assert len(content["fits"][0]["fitted_plays"]) == len(content["fits"][0]["held_out_plays"]) == 1


def test_what_a_model_does_not_state_is_told_in_one_line(tmp_path: Path) -> None:
    path = write_rig(tmp_path)
    content = yaml.safe_load(path.read_text())
    del content["drives"]["a"]["values"]["torque"]
    path.write_text(yaml.safe_dump(content))
    bag = record(load_model(path), tmp_path / "bag")
    (line,) = [
        t for t in eps_tunnel("compare", "--real", bag, "--model", path).stdout.splitlines() if "Not stated by" in t
    ]
    assert line == "Note: Not stated by model 'm', so defaults apply: drive.a.torque 2.8 N m."
    with pytest.raises(InputError, match="Unknown parameter"):
        load_sides([bag], model=str(path), known=["*:drive.a.stifness=3"])
