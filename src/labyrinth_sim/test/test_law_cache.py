# SPDX-License-Identifier: Apache-2.0
"""Compiled laws are kept on disk, and belong to the functions that they were compiled with."""

from pathlib import Path

import pytest

from labyrinth_sim import law


def test_laws_are_compiled_again_where_a_function_that_they_call_has_changed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    read = Path.read_bytes

    def with_changed(name: str) -> str:
        monkeypatch.setattr(Path, "read_bytes", lambda file: read(file) + (b"#" if file.name == name else b""))
        return law._kept()

    as_it_is = with_changed("")
    assert as_it_is.startswith(str(tmp_path))
    for called in ("law.py", "curve.py", "friction.py"):
        assert with_changed(called) != as_it_is
    assert with_changed("rig.py") == as_it_is  # which no law calls
