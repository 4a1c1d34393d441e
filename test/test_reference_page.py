# SPDX-License-Identifier: Apache-2.0
"""docs/reference.md is what the code says."""

import sys
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="needs ROS 2 and the built workspace: make setup")
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tools"))

from reference_page import messages, nodes
from reference_page.page import page

ROOT = Path(__file__).resolve().parents[1]
PAGE = (ROOT / "docs" / "reference.md").read_text(encoding="utf-8")


def test_the_page_is_up_to_date(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "120")
    assert page() == PAGE, "run python tools/reference_page in the root of the source tree"


def test_every_program_is_on_it() -> None:
    for package in nodes.PACKAGES:
        for name in nodes.executables(package):
            assert f"{package} {name}" in PAGE


def test_every_interface_is_on_it_with_every_field() -> None:
    for kind in messages.PARTS:
        for file in messages.files(kind):
            text = PAGE.split(f"### `labyrinth_msgs/{kind}/{file.stem}`")[1].split("\n### ")[0]
            names = [name for part in messages.parts(file).values() for name, *_ in messages.rows(part)]
            assert names
            assert all(f"| {name} |" in text for name in names), file.name


def test_every_parameter_in_the_parameter_file_is_on_it() -> None:
    import yaml

    file = ROOT / "config" / "nodes" / "eps_tunnel_analysis.yaml"
    for node, content in yaml.safe_load(file.read_text(encoding="utf-8")).items():
        declared = {
            p.name for p in nodes.parameters(nodes.executables("eps_tunnel_analysis")[node.removeprefix("/**/")])
        }
        assert set(content["ros__parameters"]) <= declared, node
