# SPDX-License-Identifier: Apache-2.0
"""`eps-tunnel sequences`: what can be played, as a list and as a table of commands."""

import csv
from pathlib import Path

import numpy as np
import pytest

from eps_tunnel_analysis.cli.main import main
from eps_tunnel_analysis.sequence_file import find_sequence
from labyrinth_sim import config


def test_every_sequence_is_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["sequences"]) == 0
    listed = capsys.readouterr().out
    assert all(name in listed for name in config.names("sequences"))


def test_the_table_holds_the_samples_that_are_played(tmp_path: Path) -> None:
    file = tmp_path / "commands.csv"
    assert main(["sequences", "excite_12s", "--csv", str(file), "--rate", "50"]) == 0
    command = find_sequence("excite_12s").commands[0]
    time, targets = command.sample(50.0)
    with file.open(newline="", encoding="utf-8") as stream:
        header, *rows = csv.reader(stream)
    written = np.array(rows, dtype=float)
    assert header == ["time", *command.channels]
    np.testing.assert_allclose(written[:, 0], time, atol=1e-6)
    np.testing.assert_allclose(written[:, 1:], targets, atol=1e-9)


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["excite_12s", "--csv", "there.csv"], "never overwritten"),
        (["rotations_x", "--csv", "new.csv"], "name one of rotations_x/-5.0deg"),
        (["--csv", "new.csv"], "name the sequence"),
        (["excite_13s"], "Did you mean 'excite_12s'?"),
    ],
)
def test_bad_input_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], arguments: list[str], told: str
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("there.csv").write_text("mine")
    assert main(["sequences", *arguments]) == 2
    assert told in capsys.readouterr().err
    assert Path("there.csv").read_text() == "mine"
    assert not Path("new.csv").exists()
