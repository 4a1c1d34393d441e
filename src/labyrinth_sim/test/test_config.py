# SPDX-License-Identifier: Apache-2.0
import os
from pathlib import Path

import pytest

from labyrinth_sim import config
from labyrinth_sim.errors import InputError


@pytest.fixture
def mine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A user's own folder of rigs, named in the environment after one that does not exist."""
    (tmp_path / "rigs" / "arms").mkdir(parents=True)
    (tmp_path / "rigs" / "arm.yaml").touch()
    (tmp_path / "rigs" / "arms" / "two_link.yml").touch()
    monkeypatch.setenv(config.VARIABLE, os.pathsep.join([str(tmp_path / "nowhere"), str(tmp_path)]))
    return tmp_path


def test_a_path_is_taken_as_it_is(tmp_path: Path) -> None:
    (tmp_path / "labyrinth.yaml").touch()
    assert config.find("rigs", tmp_path / "labyrinth.yaml") == (tmp_path / "labyrinth.yaml").resolve()


def test_a_name_is_found_with_and_without_its_suffix(mine: Path) -> None:
    expected = (mine / "rigs" / "arm.yaml").resolve()
    assert config.find("rigs", "arm") == config.find("rigs", "arm.yaml") == expected
    assert config.find("rigs", "arms/two_link").name == "two_link.yml"


def test_names_hold_what_find_finds(mine: Path) -> None:
    names = config.names("rigs")
    assert {"arm", "arms/two_link", "labyrinth"} <= set(names)
    assert all(config.find("rigs", name).is_file() for name in names)


def test_the_users_folder_goes_before_ours(mine: Path) -> None:
    (mine / "rigs" / "labyrinth.yaml").touch()
    assert config.find("rigs", "labyrinth") == (mine / "rigs" / "labyrinth.yaml").resolve()


def test_installed_files_are_found_under_every_prefix(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "share" / "my_robot" / "config" / "rigs"
    folder.mkdir(parents=True)
    (folder / "robot.yaml").touch()
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))
    assert config.find("rigs", "robot") == (folder / "robot.yaml").resolve()


def test_an_unknown_name_tells_the_valid_ones_and_where_it_looked(mine: Path) -> None:
    with pytest.raises(InputError) as caught:
        config.find("rigs", "arn")
    text = str(caught.value)
    assert "Unknown rig 'arn'. Did you mean 'arm'?" in text
    assert "labyrinth" in text
    assert str((mine / "rigs").resolve()) in text
    assert config.VARIABLE in text


@pytest.mark.parametrize("name", ["x" * 5000, "~nobody-of-this-name/x", "a\0b", "", "/dev/zero"])
def test_a_name_that_no_file_can_have_is_unknown(name: str) -> None:
    with pytest.raises(InputError, match="Unknown rig"):
        config.find("rigs", name)


def test_a_tilde_is_a_home_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    assert config.typed_path("~/rig.yaml") == tmp_path / "rig.yaml"
    assert config.typed_path("~nobody-of-this-name/x") == Path("~nobody-of-this-name/x")


def test_a_kind_without_any_folder_says_so() -> None:
    with pytest.raises(InputError, match="no folder named gadgets"):
        config.find("gadgets", "x")
