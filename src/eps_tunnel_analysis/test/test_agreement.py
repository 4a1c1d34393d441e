# SPDX-License-Identifier: Apache-2.0
"""Recordings of one rig agree on its values, or the one that does not is told."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from fit_cases import TRUTH, bag_of, made_by, start, step

from eps_tunnel_analysis.calibration.calibrate import Fit, Settings, calibrate
from eps_tunnel_analysis.fit.methods import GaussNewton
from eps_tunnel_analysis.inputs import load_recorded
from eps_tunnel_analysis.recorded_play import Play
from eps_tunnel_analysis.stamped import stamped_from_grid

QUICK = GaussNewton(scouts=4, starts=1, passes=0)
FREE = ("drive.x.p", "drive.x.delay")


def of_bags(*rigs: float, seed: int = 0, trials: int = 3) -> Play:
    """One command played by rigs with these P, a recording each: "bag 0", "bag 1"."""
    parts = [
        made_by(start().with_values({**TRUTH, "drive.x.p": p}), step(3.0), trials=trials, seed=seed + i)
        for i, p in enumerate(rigs)
    ]
    values, commands = (np.concatenate([getattr(part, name) for part in parts]) for name in ("values", "commands"))
    together = replace(parts[0], values=values, commands=commands)
    stamped = [replace(t, bag=f"bag {i // trials}") for i, t in enumerate(stamped_from_grid(together))]
    return Play("step", together, stamped=tuple(stamped))


def fit(play: Play) -> Fit:
    settings = Settings(method=QUICK, nthread=1, signals=("motor_x", "board_x"))
    return calibrate(start().with_values({**TRUTH, "drive.x.p": 16.0}), FREE, [play], settings)


def disagreements(play: Play) -> list[str]:
    return [text for text in fit(play).warnings if text.startswith("Recordings disagree")]


def test_recordings_of_one_rig_agree() -> None:
    told = [disagreements(of_bags(18.0, 18.0, 18.0, seed=10 * i)) for i in range(5)]
    assert sum(map(bool, told)) <= 1, told


def test_the_recording_of_another_rig_is_told_with_its_value() -> None:
    told = disagreements(of_bags(18.0, 18.0, 19.0))
    (text,) = (t for t in told if "bag 2" in t and "drive.x.p" in t)
    alone = float(text.split("drive.x.p at ")[1].split()[0])
    assert abs(alone - 19.0) < 0.3, text


def test_of_one_recording_nothing_is_said() -> None:
    assert disagreements(of_bags(18.0)) == []
    play = of_bags(18.0, 19.0)
    assert disagreements(replace(play, stamped=())) == [], "nobody knows which trial is from where"


def test_trials_know_which_recording_they_are_from(tmp_path: Path) -> None:
    bags = [bag_of(tmp_path / name, made_by(start(), step(3.0), trials=1)) for name in ("may", "june")]
    (play,) = load_recorded("labyrinth", bags).plays
    assert [trial.bag for trial in play.stamped] == [str(bag) for bag in bags]
    assert [trial.shifted(0.01).bag for trial in play.stamped] == [str(bag) for bag in bags]
