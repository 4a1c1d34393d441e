# SPDX-License-Identifier: Apache-2.0
"""`eps-tunnel changes` as a user meets it: bags of three dates, files."""

import csv
import json
from dataclasses import replace
from pathlib import Path

import pytest
from command_line import eps_tunnel, refused
from fit_cases import bag_of, made_by, start, step

from labyrinth_sim.model import load_model

TRUTH = {"drive.x.p": 18.0, "drive.x.delay": 0.03}


@pytest.fixture(scope="module")
def dates(tmp_path_factory) -> Path:
    """Three bags of each of three dates; the drive's gain falls."""
    folder = tmp_path_factory.mktemp("dates")
    for seed, (date, p) in enumerate({"may": 18.0, "june": 16.0, "july": 14.0}.items()):
        trials = made_by(start().with_values({**TRUTH, "drive.x.p": p}), step(3.0), seed=seed)
        for i in range(trials.count):
            one = replace(trials, values=trials.values[i : i + 1], commands=trials.commands[i : i + 1])
            bag_of(folder / date / f"bag{i}", one)
    model = folder / "rig.yaml"
    text = Path(str(load_model("labyrinth").path)).read_text()
    model.write_text(
        text.replace("p: {value: 1.0", "p: {value: 18.0").replace("delay: {value: 0.0", "delay: {value: 0.03")
    )
    return folder


def test_it_names_the_value_that_changed_and_draws_the_dates(dates: Path, tmp_path: Path) -> None:
    out = tmp_path / "wear"
    result = eps_tunnel(
        "changes", "--then", dates / "may", "--also", f"june={dates / 'june'}", "--now", dates / "july", "--model",
        dates / "rig.yaml", "--keep-values", "--candidates", "drive", "coulomb_friction.x", "--out", out,
    )  # fmt: skip
    assert result.returncode == 0, result.stderr
    assert "What changed is drive.x.p" in result.stdout
    assert {p.name for p in out.iterdir()} == {"changes.json", "then.yaml", "dates.csv", "dates.svg"}
    told = json.loads((out / "changes.json").read_text())
    (value,) = told["values"]
    assert (value["name"], value["then"]) == ("drive.x.p", 18.0)
    assert abs(value["now"] - 14.0) < value["half_width"] < 2.0
    with (out / "dates.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert [r["date"] for r in rows] == ["then", "june", "now"]
    assert rows[0]["drive.x.p"] == "" and float(rows[1]["drive.x.p"]) == pytest.approx(16.0, abs=0.5)
    assert 0 < float(rows[1]["alikeness_k1_rig"]) < 1
    for row, date in zip(rows, told["dates"], strict=True):
        for at in date["alikeness"]:
            assert float(row[f"alikeness_k{at['k']:g}_rig"]) == at["rig_against_itself"]
    assert "<svg" in (out / "dates.svg").read_text()


def test_what_is_wrong_with_its_arguments_is_said(dates: Path, tmp_path: Path) -> None:
    call = ["--then", dates / "may", "--now", dates / "july", "--model", dates / "rig.yaml"]
    refused("changes", *call, "--also", dates / "june", told=["expected LABEL=BAG"])
    refused("changes", *call, "--also", f"now={dates / 'june'}", told=["'now' is taken"])
    refused("changes", *call, "--out", dates, told=["exists already"])
