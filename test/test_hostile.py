# SPDX-License-Identifier: Apache-2.0
"""Whatever comes from a file or the command line is read or refused: no traceback, nothing left, little memory."""

import contextlib
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from eps_tunnel_analysis.recording.csv_import import CsvColumns, csv_to_bag
from eps_tunnel_analysis.sequence_file import parse_sequence
from labyrinth_sim.errors import InputError
from labyrinth_sim.model import load_model
from labyrinth_sim.yaml_file import parse_yaml, yaml_text

BENCHMARK = Path(__file__).resolve().parents[1] / "benchmarks" / "hostile.py"
TRIES, SEED = 80, 1_000_000
steady = settings(max_examples=25, deadline=None, derandomize=True, database=None,
                  suppress_health_check=[HealthCheck.too_slow])  # fmt: skip

words = st.one_of(st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=8), st.dates().map(str))
data = st.recursive(
    words, lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner, max_size=3)
)


@pytest.fixture(scope="module")
def counts(tmp_path_factory: pytest.TempPathFactory) -> dict:
    """Of damaged files and options, tried in processes whose memory is limited."""
    out = tmp_path_factory.mktemp("hostile") / "counts.json"
    one_thread = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    line = [sys.executable, str(BENCHMARK), "--tries", str(TRIES), "--seed", str(SEED), "--json", str(out)]
    done = subprocess.run(line, capture_output=True, text=True, env={**os.environ, **one_thread}, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(out.read_text(encoding="utf-8"))


@pytest.mark.study
def test_damaged_files_and_options_are_read_or_refused(counts: dict) -> None:
    assert counts["failures"] == []
    assert counts["refused"] + counts["handled"] == counts["tries"] == TRIES


@pytest.mark.study
def test_the_attacks_reach_behind_the_first_check(counts: dict) -> None:
    assert counts["refused"] > TRIES / 4 and counts["handled"] > TRIES / 10


@steady
@given(st.text(max_size=200))
def test_any_text_is_yaml_or_refused(text: str) -> None:
    with contextlib.suppress(InputError):
        parse_yaml(text, "x.yaml")


PLACES = ("description", "initial_deg", "trials", "command", "commands", "initial")


@steady
@given(st.dictionaries(st.sampled_from(PLACES), data), st.sampled_from(("hold", "step", "sine", "ramp", "chirp")), data)
def test_any_data_is_a_sequence_or_refused(parts: dict, shape: str, numbers: object) -> None:
    whole = {"initial_deg": {"a": 0}, "command": {"a": [{shape: numbers}]}, **parts}
    with contextlib.suppress(InputError):
        parse_sequence(whole, "x", "x.yaml")
    with contextlib.suppress(InputError):
        parse_sequence(parse_yaml(yaml_text(whole), "x.yaml").data, "x", "x.yaml")


@steady
@given(data, st.sampled_from(("drives", "effects", "quantities", "provenance", "rig", "name")))
def test_any_data_is_a_model_or_refused(content: object, place: str) -> None:
    drive = {"kind": "velocity_pid", "values": {}}
    whole = {"name": "m", "rig": "labyrinth", "drives": {"x": drive, "y": drive}, "effects": [], place: content}
    with tempfile.TemporaryDirectory() as folder, contextlib.suppress(InputError):
        file = Path(folder) / "m.yaml"
        file.write_text(yaml_text(whole), encoding="utf-8", errors="surrogatepass")
        load_model(file)


cells = st.one_of(st.floats().map(str), st.integers().map(str), st.text(max_size=6), st.just(""))


@steady
@given(st.lists(st.tuples(cells, cells, cells), max_size=5), st.booleans())
@example([("0.0", "0.0", "0.0"), ("2147483647.0", "0.0", "")], False)
def test_any_table_becomes_a_bag_or_is_refused(rows: list[tuple[str, str, str]], counted: bool) -> None:
    lines = [",".join((str(i) if counted else first, *rest)) for i, (first, *rest) in enumerate(rows)]
    columns = CsvColumns("t", commands={"a": "goal"}, position={"a": "angle"})
    with tempfile.TemporaryDirectory() as name:
        table, out = Path(name) / "log.csv", Path(name) / "bag"
        table.write_text("\n".join(["t,goal,angle", *lines]), encoding="utf-8", errors="surrogatepass")
        try:
            csv_to_bag(table, columns, out)
        except InputError:
            assert list(Path(name).iterdir()) == [table]
        else:
            assert sorted(path.name for path in Path(name).iterdir()) == ["bag", "log.csv"]
