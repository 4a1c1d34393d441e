# SPDX-License-Identifier: Apache-2.0
"""A table becomes the bag that a recorder would have written."""

from pathlib import Path

import numpy as np
import pytest

from eps_tunnel_analysis.recording import CsvColumns, csv_to_bag, read, read_trials
from labyrinth_sim.errors import InputError

COLUMNS = CsvColumns("t", commands={"motor_x": "goal"}, position={"motor_x": "angle"}, effort={"motor_x": "amps"})


def table(path: Path, rows: list[str], header: str = "t,goal,angle,amps") -> Path:
    path.write_text("\n".join([header, *rows]) + "\n", encoding="utf-8")
    return path


def test_a_table_becomes_trials(tmp_path: Path) -> None:
    rows = [f"{5 + i / 100},{0.01 * i},{0.02 * i},{0.5}" for i in range(51)]
    assert csv_to_bag(table(tmp_path / "log.csv", rows), COLUMNS, tmp_path / "bag") == []
    trials = read_trials([tmp_path / "bag"]).trials
    assert trials.signals == ("motor_x", "motor_x_effort")
    assert np.allclose(trials.values[0, :, 0], 0.02 * np.arange(51))
    assert np.allclose(trials.commands[0, :, 0], 0.01 * np.arange(51))


def test_empty_cells_are_messages_that_were_not_sent(tmp_path: Path) -> None:
    csv_to_bag(table(tmp_path / "log.csv", ["0,0.1,0.0,1", "0.01,,0.1,1", "0.02,,,"]), COLUMNS, tmp_path / "bag")
    topics = read(tmp_path / "bag").topics
    assert len(topics["/real/joint_commands"]) == 1
    assert len(topics["/real/joint_states"]) == 2


@pytest.mark.parametrize(
    ("rows", "header", "match"),
    [
        (["0,0,0,0"], "t,target,angle,amps", "Unknown column 'goal'"),
        (["0,0,x,0"], "t,goal,angle,amps", "line 2, column 'angle': 'x' is not a number"),
        (["0,0,nan,0"], "t,goal,angle,amps", "not finite"),
        (["0,0,0,0", "0,0,0,0"], "t,goal,angle,amps", "line 3: the time '0' does not increase"),
        ([], "t,goal,angle,amps", "no rows"),
        (["0,0,0,"], "t,goal,angle,amps", "only some measurement cells"),
    ],
)
def test_a_bad_table_is_told_by_its_line(tmp_path: Path, rows: list[str], header: str, match: str) -> None:
    with pytest.raises(InputError, match=match):
        csv_to_bag(table(tmp_path / "log.csv", rows, header), COLUMNS, tmp_path / "bag")
