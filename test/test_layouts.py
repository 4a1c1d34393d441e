# SPDX-License-Identifier: Apache-2.0
"""The layouts for PlotJuggler and Foxglove or Lichtblick name only topics and fields that exist."""

import json
import re
import sys
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from labyrinth_hw.testbed.bags import write_bag
from labyrinth_hw.testbed.hidden import load_testbed
from labyrinth_hw.testbed.offline import run_offline
from labyrinth_sim.rig import load_rig

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tools"))
from reference_page import messages, nodes

ROOT = Path(__file__).resolve().parents[1]
PLOTJUGGLER = ET.parse(ROOT / "config" / "layouts" / "plotjuggler.xml").getroot()
FOXGLOVE = json.loads((ROOT / "config" / "layouts" / "foxglove.json").read_text(encoding="utf-8"))
PANELS = {"Plot", "StateTransitions", "RawMessages", "DiagnosticSummary", "Tab"}
JOINT_STATE = "sensor_msgs/msg/JointState"
WANTED = {"/real/joint_commands", "/real/joint_states", "/sim/joint_states", "/real/ball", "/sim/ball", "/srg",
          "/srg/tunnel", "/srg/motor_x/alikeness", "/real/trial", "/sim/trial"}  # fmt: skip


def store() -> Any:
    made = get_typestore(Stores.ROS2_KILTED)
    types: dict[str, Any] = {}
    for file in messages.files("msg"):
        types |= get_types_from_msg(file.read_text(encoding="utf-8"), f"labyrinth_msgs/msg/{file.stem}")
    made.register(types)
    return made


STORE = store()
POSITIONS = [
    name for name, unit in zip(load_rig("labyrinth").signals, load_rig("labyrinth").units, strict=True) if unit == "rad"
]


@cache
def topics() -> dict[str, str]:
    """Name -> type of every topic of the labyrinth's nodes."""
    return {
        "/" + name.replace("NS", side).replace("SIGNAL", signal).lstrip("/"): kind
        for name, kind in nodes.topics().items()
        for side in ("real", "sim")
        for signal in POSITIONS
    }


@pytest.fixture(scope="module")
def order(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[str]]:
    """Names in the messages of a bag, in their order."""
    folder = tmp_path_factory.mktemp("bag") / "real"
    run = run_offline(load_testbed("healthy"), np.arange(5) / 100, np.zeros((5, 2)), 1, 0)
    write_bag(folder, run, "rest", "")
    with AnyReader([folder]) as reader:
        told = {c.topic: reader.deserialize(data, c.msgtype) for c, _, data in reader.messages()}
    return {name: list(told[f"/real/{name}"].name) for name in ("joint_states", "joint_commands")}


def is_number(kind: str, field: str, index: str | None) -> bool:
    """Whether a message type has the field, and as a number, or numbers if there is an index."""
    known = dict(STORE.fielddefs[kind][1])
    if field not in known:
        return False
    node, *inner = known[field]
    many = node in (Nodetype.ARRAY, Nodetype.SEQUENCE)
    base = inner[0][0] if many else (node, *inner)
    return many == (index is not None) and base[0] == Nodetype.BASE and base[1][0] != "string"


def split(series: str) -> tuple[str, str]:
    """The topic that a path begins with, and the rest."""
    topic = max((t for t in topics() if series.startswith(t)), key=len, default="")
    assert topic, f"{series}: no such topic. Topics: {', '.join(sorted(topics()))}"
    return topic, series[len(topic) :]


def series_of_plotjuggler() -> Iterator[str]:
    """Every series that must come from messages."""
    made = {snippet.attrib["name"] for snippet in PLOTJUGGLER.iter("snippet")}
    for curve in PLOTJUGGLER.iter("curve"):
        yield from (curve.attrib[key] for key in ("curve_x", "curve_y") if key in curve.attrib)
        if "curve_x" not in curve.attrib and curve.attrib["name"] not in made:
            yield curve.attrib["name"]
    for snippet in PLOTJUGGLER.iter("snippet"):
        yield snippet.findtext("linked_source", "")
        yield from (source.text or "" for source in snippet.findall("additional_sources/*"))


def paths_of_foxglove() -> Iterator[str]:
    for panel in FOXGLOVE["configById"].values():
        yield from (path["value"] for path in panel.get("paths", []))
        yield from (panel[key] for key in ("topicPath", "topicToRender") if key in panel)


@pytest.mark.parametrize("series", sorted(set(series_of_plotjuggler())))
def test_every_series_of_plotjuggler_exists(series: str, order: dict[str, list[str]]) -> None:
    topic, rest = split(series)
    if topics()[topic] == JOINT_STATE:  # PlotJuggler names these by joint
        joint, field = rest.strip("/").split("/")
        assert joint in order[topic.rsplit("/", 1)[1]]
        assert is_number(JOINT_STATE, field, "0")
    else:
        match = re.fullmatch(r"/(\w+)(?:\[(\d+)\])?", rest)
        assert match, series
        assert is_number(topics()[topic], match[1], match[2]), series


@pytest.mark.parametrize("path", sorted(set(paths_of_foxglove())))
def test_every_path_of_foxglove_exists(path: str) -> None:
    topic, rest = split(path)
    match = re.fullmatch(r"(?:\{(\w+)==(?:true|false|\d+)\})?(?:\.(\w+)(?:\[(\d+)\])?)?", rest)
    assert match, path
    condition, field, index = match.groups()
    assert condition is None or is_number(topics()[topic], condition, None)
    # A state may also be a word.
    words = field == "sequence" and field in dict(STORE.fielddefs[topics()[topic]][1])
    assert field is None or words or is_number(topics()[topic], field, index), path


def test_both_show_every_stream() -> None:
    assert {split(series)[0] for series in series_of_plotjuggler()} >= WANTED
    assert {split(path)[0] for path in paths_of_foxglove()} >= WANTED


def test_plotjuggler_subscribes_to_all_that_it_shows() -> None:
    chosen = PLOTJUGGLER.find("Plugins/plugin/selected_topics")
    assert chosen is not None
    assert set(chosen.attrib["value"].split(";")) == {split(series)[0] for series in series_of_plotjuggler()}


def test_an_index_means_the_joint_that_the_title_names(order: dict[str, list[str]]) -> None:
    for name, panel in FOXGLOVE["configById"].items():
        if name.startswith("Plot!angle_"):
            joint = name.removeprefix("Plot!angle_")
            for path in panel["paths"]:
                topic, _, index = re.split(r"\.(\w+)", path["value"])
                names = order[topic.rsplit("/", 1)[1]]
                assert names[int(index.strip("[]"))][-1] == joint[-1]
                assert topic.endswith("joint_commands") or names[int(index.strip("[]"))] == joint


def test_splitters_of_plotjuggler_hold_what_they_count() -> None:
    for splitter in PLOTJUGGLER.iter("DockSplitter"):
        sizes = [float(size) for size in splitter.attrib["sizes"].split(";")]
        assert len(splitter) == int(splitter.attrib["count"]) == len(sizes)
        assert sum(sizes) == pytest.approx(1, abs=1e-3)


def test_panels_of_foxglove_are_placed_once_and_configured() -> None:
    def leaves(node: Any) -> list[str]:
        if isinstance(node, str):
            return [node]
        assert node["direction"] in ("row", "column")
        return leaves(node["first"]) + leaves(node["second"])

    placed = leaves(FOXGLOVE["layout"])
    for panel in FOXGLOVE["configById"].values():
        placed += [leaf for tab in panel.get("tabs", []) for leaf in leaves(tab["layout"])]
    assert sorted(placed) == sorted(FOXGLOVE["configById"])
    assert {name.split("!")[0] for name in placed} <= PANELS
