# SPDX-License-Identifier: Apache-2.0
import contextlib
import os
import resource
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pydantic import Field

from labyrinth_sim.errors import InputError
from labyrinth_sim.model import load_model
from labyrinth_sim.rig import load_rig
from labyrinth_sim.yaml_file import DEEPEST, LARGEST, MOST_COMPLAINTS, Entry, Text, parse_yaml, read_yaml, yaml_text


class Spring(Entry):
    stiffness: Annotated[float, Field(gt=0.0, json_schema_extra={"unit": "N/m"})]
    turns: int = 1
    maker: Text = ""


def nested(levels: int) -> str:
    return "a: " + "[" * levels + "]" * levels


def bomb(levels: int) -> str:
    """Nine aliases of nine aliases and so on: 9^levels values in a few hundred bytes."""
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x]"]
    return "\n".join(lines + [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]" for i in range(1, levels)])


def chain(levels: int) -> str:
    return "a0: &a0 {x: 1}\n" + "".join(f"a{i}: &a{i} {{x: *a{i - 1}}}\n" for i in range(1, levels))


REFUSED = {
    "nested lists": (nested(3500), f"more than {DEEPEST} mappings and lists"),
    "nested mappings": ("a: " + "{b: " * 200_000, f"more than {DEEPEST}"),
    "nested by indentation": ("\n".join(" " * i + "a:" for i in range(1000)), f":{DEEPEST + 1}: more than"),
    "nested by aliases": (chain(200), "mappings and lists within each other"),
    "alias bomb": (bomb(12), "values, those that aliases repeat included"),
    "alias bomb of text": (f"a: &a '{'x' * 100_000}'\nb: [{','.join(['*a'] * 1000)}]", "values"),
    "alias of itself": ("a: &a [*a]", "the alias *a names nothing"),
    "many values": (f"a: [{'1,' * 400_000}]", "more than"),
    "many keys": ("\n".join(f"k{i}: 1" for i in range(60_000)), "more than"),
    "huge integer": ("a: " + "9" * 500_000, "1: a number of 500000 characters"),
    "huge hexadecimal": ("a: 0x" + "f" * 500_000, "characters"),
    "a list as key": ("a: 1\n[1, 2]: 3", ":2: a key must be one word"),
    "a mapping as key": ("? {a: 1}\n: 2", "a key must be one word"),
    "a key twice": ("a: 1\na: 2", ":2: the key 'a' is given twice"),
    "Python objects": ("a: !!python/object/apply:os.system [ls]", "the tag"),
    "a set": ("a: !!set {b}", "the tag"),
    "a wrong integer": ("a: !!int abc", "expected a number"),
    "two documents": ("a: 1\n---\nb: 2", "another document"),
    "no mapping": ("[1, 2]", "expected a mapping, got [1, 2]"),
    "nothing": ("", "expected a mapping, got nothing"),
    "broken": ("a: [", "not valid YAML"),
    "a control character": ("a: \x00", "not valid YAML"),
    "no character": ('a: "\\UFFFFFFFF"', "not valid YAML"),
    "too large": ("#" * (LARGEST + 1), "larger than 1 MiB"),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_no_file_of_ours_is_refused_with_its_line(tmp_path: Path, name: str) -> None:
    text, complaint = REFUSED[name]
    path = tmp_path / "file.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError) as caught:
        read_yaml(path)
    assert str(path) in str(caught.value)
    assert complaint in str(caught.value)
    assert len(str(caught.value)) < 1000


def limited() -> None:
    """Of a child process: bounds that any of the files above would break if it were read in full."""
    resource.setrlimit(resource.RLIMIT_CPU, (60, 60))
    resource.setrlimit(resource.RLIMIT_AS, (1 << 30, 1 << 30))


def test_hostile_files_cost_little(tmp_path: Path) -> None:
    for i, (text, _) in enumerate(REFUSED.values()):
        (tmp_path / f"{i}.yaml").write_text(text, encoding="utf-8")
    program = """
import sys
from pathlib import Path
from labyrinth_sim.errors import InputError
from labyrinth_sim.yaml_file import read_yaml
for path in Path(sys.argv[1]).glob("*.yaml"):
    try:
        read_yaml(path)
    except InputError:
        continue
    print(path)
"""
    done = subprocess.run(
        [sys.executable, "-c", program, str(tmp_path)], capture_output=True, text=True, preexec_fn=limited, timeout=300
    )
    assert (done.returncode, done.stdout) == (0, ""), done.stderr


def test_bytes_that_are_no_text_and_no_file_at_all(tmp_path: Path) -> None:
    (tmp_path / "bytes.yaml").write_bytes(b"a: \xff")
    for path, complaint in (
        (tmp_path / "bytes.yaml", "no UTF-8"),
        (tmp_path, "cannot be read"),
        (tmp_path / "nowhere.yaml", "cannot be read"),
    ):
        with pytest.raises(InputError, match=complaint):
            read_yaml(path)
    os.mkfifo(tmp_path / "pipe.yaml")  # opening it would wait for a writer
    with pytest.raises(InputError, match="cannot be read"):
        read_yaml(tmp_path / "pipe.yaml")


def test_plain_words_mean_what_yaml_1_2_says() -> None:
    text = """
numbers: [1, -2, 1e-3, 1.5, .5, 0x10, 010, .inf]
text: [on, no, 2020-99-99, 2020-01-31, 1_000, "1", 1:30, <]
1: a
null: b
2020-01-31: c
nothing: [~, null, ]
yes: [true, False]
"""
    data = parse_yaml(text, "x").data
    assert data["numbers"] == [1, -2, 1e-3, 1.5, 0.5, 16, 10, float("inf")]
    assert data["text"] == ["on", "no", "2020-99-99", "2020-01-31", "1_000", "1", "1:30", "<"]
    assert (data["1"], data["null"], data["2020-01-31"]) == ("a", "b", "c")
    assert (data["nothing"], data["yes"]) == ([None, None], [True, False])


def test_aliases_and_merges_share_values() -> None:
    text = "a: &a {x: 1, y: 2}\nb: *a\nc: {<<: *a, y: 3}\nd: {<<: [*a, {z: 1, x: 5}]}"
    data = parse_yaml(text, "x").data
    assert (data["b"], data["c"], data["d"]) == ({"x": 1, "y": 2}, {"x": 1, "y": 3}, {"x": 1, "y": 2, "z": 1})
    with pytest.raises(InputError, match="'<<' takes a mapping"):
        parse_yaml("a: {<<: 3}", "x")


def test_every_complaint_says_file_line_and_place() -> None:
    document = parse_yaml(
        "springs:\n  front:\n    stiffnes: 1\n    turns: 1.5\n    maker: [x]\n  rear: 7\n", "car.yaml"
    )
    for name in ("front", "rear"):
        assert document.read(Spring, ("springs", name)) is None
    assert document.complaints == [
        "car.yaml:2: springs.front: 'stiffness' is missing.",
        "car.yaml:3: springs.front: Unknown entry 'stiffnes'. Did you mean 'stiffness'? "
        "Available entry names: maker, stiffness, turns.",
        "car.yaml:4: springs.front.turns: expected a whole number, got 1.5.",
        "car.yaml:5: springs.front.maker: expected text, got ['x'].",
        "car.yaml:6: springs.rear: expected a mapping, got 7.",
    ]
    with pytest.raises(InputError):
        document.check()


@pytest.mark.parametrize(
    ("value", "complaint"),
    [("0", "must be greater than 0 N/m, got 0"), (".nan", "a finite number"), ("true", "expected a number, got True")],
)
def test_numbers_are_checked_with_their_unit(value: str, complaint: str) -> None:
    document = parse_yaml(f"spring: {{stiffness: {value}}}", "x")
    assert document.read(Spring, ("spring",)) is None
    assert complaint in document.complaints[0]
    assert parse_yaml("spring: {stiffness: 2, maker: 5}", "x").read(Spring, ("spring",)) == Spring(stiffness=2, maker=5)


def test_a_file_with_too_many_faults_is_not_checked_to_its_end() -> None:
    document = parse_yaml("a:\n" + "".join(f"  k{i}: 1\n" for i in range(2000)), "x")
    with pytest.raises(InputError) as caught:
        document.read(Spring, ("a",))
    assert len(caught.value.complaints) == MOST_COMPLAINTS + 1


words = st.sampled_from(
    ["on", "1e3", "1.0e+3", "null", "~", "2020-01-31", "0x1F", "1_0", "<<", "-", "", " a", "x: y", "#"]
)
values = st.recursive(
    st.none() | st.booleans() | st.integers(-(10**9), 10**9) | st.floats(allow_nan=False) | words | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(words | st.text(max_size=4), inner, max_size=3),
    max_leaves=8,
)


@settings(max_examples=100, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])
@given(st.dictionaries(words, values, max_size=3))
def test_what_is_written_is_read_back(data: dict[str, object]) -> None:
    assert parse_yaml(yaml_text(data), "x").data == data


LOADERS: dict[str, Callable[[Path], object]] = {"rigs": load_rig, "models": load_model}
PIECES = [
    "1",
    "null",
    "2020-99-99",
    "[]",
    "{}",
    "!!set {a}",
    "9" * 50,
    "&a [*a]",
    "*b",
    "'",
    "\t",
    "- ",
    "1e999",
    "\x00",
]


@pytest.mark.parametrize("kind", LOADERS)
@settings(max_examples=150, deadline=None, derandomize=True)
@given(data=st.data())
def test_a_damaged_file_is_read_or_refused(
    kind: str, data: st.DataObject, tmp_path_factory: pytest.TempPathFactory
) -> None:
    whole = LOADERS[kind](Path("labyrinth")).path.read_text(encoding="utf-8")  # type: ignore[attr-defined]
    start = data.draw(st.integers(0, len(whole)))
    end = data.draw(st.integers(start, min(len(whole), start + 40)))
    path = tmp_path_factory.mktemp("damaged") / "file.yaml"
    path.write_text(whole[:start] + data.draw(st.sampled_from(PIECES)) + whole[end:], encoding="utf-8")
    with contextlib.suppress(InputError):  # anything else is a failure
        LOADERS[kind](path)


@pytest.mark.parametrize("key", ["1", "null", "2020-01-01", "true", "1.5", "~"])
@pytest.mark.parametrize("entry", ["", "drives", "quantities"])
def test_keys_that_are_no_text_are_refused(tmp_path: Path, key: str, entry: str) -> None:
    text = load_model("horn").path.read_text(encoding="utf-8")  # type: ignore[union-attr]
    if entry == "drives":
        text = text.replace("drives:\n", f"drives:\n  {key}: 3\n")
    else:
        text += f"{entry}: {{{key}: 3}}\n" if entry else f"{key}: 3\n"
    (tmp_path / "model.yaml").write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=f"'{key}'"):
        load_model(tmp_path / "model.yaml")


@pytest.mark.parametrize("wrong", ["[]", "3", "text", "2020-99-99", "[{}]", "9999999999999999999999999999999"])
@pytest.mark.parametrize("entry", ["quantities", "effects", "drives", "provenance"])
def test_an_entry_of_another_kind_is_refused(tmp_path: Path, entry: str, wrong: str) -> None:
    horn = yaml.safe_load(load_model("horn").path.read_text(encoding="utf-8"))  # type: ignore[union-attr]
    horn.pop(entry, None)
    (tmp_path / "model.yaml").write_text(yaml.safe_dump(horn) + f"{entry}: {wrong}\n", encoding="utf-8")
    if (entry, wrong) == ("effects", "[]"):
        assert load_model(tmp_path / "model.yaml").effects == ()
        return
    with pytest.raises(InputError, match=entry):
        load_model(tmp_path / "model.yaml")
