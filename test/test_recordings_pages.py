# SPDX-License-Identifier: Apache-2.0
"""What the pages of real recordings are made of, where the recordings are not at hand."""

import shlex
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))

import recordings

from eps_tunnel_analysis.terminal import print_next, text_of

RULES = ["/data/a folder/kp_100/*:drive.pendulum.kp=28.71", "/data/kp_200/*:drive.pendulum.kp=57.5"]


def printed(known: list[str]) -> str:
    """As new-rig ends."""
    words = ["diagnose", "--real", "/data/a", *(["--known", *known] if known else []), "--model", "m.yaml"]
    said = "Every command needs --known as below. Next: what is missing."
    return text_of(lambda out: print_next(out, said, shlex.join(["eps-tunnel", *words])))


def test_what_differs_between_recordings_is_read_from_the_next_command() -> None:
    assert recordings._known(printed(RULES)) == RULES
    assert recordings._known(printed([])) == []


def test_numbers_are_written_without_powers_of_ten() -> None:
    assert [recordings._number(v) for v in (16599.28, 78.04, 0.021342)] == ["16,600", "78", "0.0213"]


def figures(**more: object) -> dict[str, object]:
    """Of a diagnosis that found nothing known."""
    return {"commands": [], "verdict": "unknown", "sentence": "Something is missing.", "axes": {}, "given": [],
            "refitted": [], "after": [], "evaluations": 1, **more}  # fmt: skip


def test_the_page_says_what_the_law_says_where_one_is_proposed() -> None:
    rig = recordings.RIGS["mx106_no_load"]
    law = {"sentence": "What is missing depends on speed.", "equation": "C speed |speed|", "base_held_out": 12.34,
           "refit": {"held_out": 1.5}}  # fmt: skip
    page = recordings.page_text(figures(proposed_effect=law), rig)
    assert "What is missing depends on speed." in page and "| C speed |speed| | 12.3 | 1.5 |" in page.replace(
        "\\|", "|"
    )
    silent = recordings.page_text(figures(proposed_effect=law | {"refit": None, "base_held_out": None}), rig)
    assert "What is missing depends on speed." in silent and "floors without it" not in silent
    assert "depends on" not in recordings.page_text(figures(proposed_effect=None), rig)
