# SPDX-License-Identifier: Apache-2.0
"""docs/answers.md has every verdict, with its picture and its sentence."""

import re
import sys
from pathlib import Path
from typing import get_args

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tools"))

from answers import CASES, PAGE, quoted

from eps_tunnel_analysis.diagnose.verdict import Kind

TEXT = PAGE.read_text(encoding="utf-8")


def test_every_verdict_has_a_case() -> None:
    assert sorted(CASES) == sorted(get_args(Kind))


@pytest.mark.parametrize("kind", sorted(get_args(Kind)))
def test_each_has_a_section_a_sentence_and_a_picture(kind: str) -> None:
    section = re.search(rf"^## {kind.capitalize()}$(.*?)(?=^## |\Z)", TEXT, flags=re.MULTILINE | re.DOTALL)
    assert section is not None
    sentence = re.search(rf"<!-- answer: {kind} -->\n> (.+)\n<!-- end -->", section[1])
    assert sentence is not None and sentence[1].endswith(".")
    picture = PAGE.parent / "pictures" / f"answer_{kind}.png"
    assert f"(pictures/{picture.name})" in section[1]
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_only_the_sentence_between_the_marks_is_replaced() -> None:
    once = quoted(TEXT, "effect", "It lacks \\1 (9%).")
    assert "<!-- answer: effect -->\n> It lacks \\1 (9%).\n<!-- end -->" in once
    assert quoted(once, "effect", re.search(r"effect -->\n> (.*)", TEXT)[1]) == TEXT  # type: ignore[index]
