# SPDX-License-Identifier: Apache-2.0
"""What the commands that diagnose have in common: options, progress, files."""

import argparse
import json
import shlex
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tqdm import tqdm

from eps_tunnel_analysis.cli.plays import Recorded, add_known_arguments
from eps_tunnel_analysis.cli.versions import versions

if TYPE_CHECKING:
    from eps_tunnel_analysis.diagnose.diagnose import Diagnosis

LINE_EVERY = 0.2
"""s between two lines of progress"""


def add_diagnosis_arguments(parser: argparse.ArgumentParser) -> None:
    """--known, --timing-ms, --held-out, --seed, --threads, --progress."""
    add_known_arguments(parser)
    parser.add_argument("--seed", type=int, default=0, help="kept with the result (default: %(default)s)")
    parser.add_argument(
        "--threads", type=int, default=0, metavar="N", help="of this machine (default: all, beside nodes all but one)"
    )
    parser.add_argument("--progress", choices=("bar", "lines"), default="bar",
                        help="on stderr: a bar, or lines of JSON for programs (default: %(default)s)")  # fmt: skip


@contextmanager
def progress(kind: str = "bar") -> Iterator[Callable[[str, int], None] | None]:
    """Counts roll-outs on stderr: by a "bar" where that is a terminal, or by "lines", one JSON object each."""
    if kind == "lines":
        yield _lines()
        return
    if not sys.stderr.isatty():
        yield None
        return
    with tqdm(desc="roll-outs", unit="", file=sys.stderr, dynamic_ncols=True) as bar:

        def told(what: str, count: int) -> None:
            if bar.desc != f"{what}: ":
                bar.set_description(what)
                bar.n = 0
            bar.update(count - bar.n)

        yield told


def _lines() -> Callable[[str, int], None]:
    last = 0.0

    def told(what: str, count: int) -> None:
        nonlocal last
        if time.monotonic() - last >= LINE_EVERY:
            last = time.monotonic()
            print(json.dumps({"doing": what, "rollouts": count}), file=sys.stderr, flush=True)

    return told


def add_command(arguments: argparse.Namespace, effects: Sequence[str]) -> str:
    """The command line that adds these effects."""
    words = ["eps-tunnel", "add-effect", *effects, "--real", *map(str, arguments.real), "--model", str(arguments.model)]
    return shlex.join([*words, "--out", f"{Path(str(arguments.model)).stem}_more.yaml"])


def write_diagnosis(
    folder: Path, diagnosis: "Diagnosis", recorded: Recorded, arguments: argparse.Namespace
) -> dict[str, Any]:
    """Writes diagnosis.json, report.html and, where there is one, the next experiment; returns the JSON's content."""
    from eps_tunnel_analysis.report.diagnosis_report import diagnosis_report

    content = diagnosis_content(diagnosis, recorded)
    (folder / "diagnosis.json").write_text(json.dumps(content, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    if diagnosis.experiment:
        (folder / "next_experiment.yaml").write_text(diagnosis.experiment.to_yaml(), encoding="utf-8")
    facts = [
        ("model", recorded.model.name),
        *[("real bag", f"{path} (SHA-256 {digest[:12]})") for path, digest in recorded.bags],
        *[("note", note) for note in recorded.notes],
        ("command", shlex.join(["eps-tunnel", *sys.argv[1:]])),
        ("versions", ", ".join(f"{name} {v}" for name, v in versions().items())),
        ("made", datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC")),
    ]
    trials = sum(play.trials.count for play in recorded.plays)
    subtitle = f"{trials} real trial{'s' * (trials > 1)}, {diagnosis.verdict.evaluations} roll-outs"
    page = diagnosis_report(
        diagnosis,
        f"What {recorded.model.name} lacks",
        subtitle,
        add_command(arguments, diagnosis.verdict.effects),
        facts,
    )
    (folder / "report.html").write_text(page, encoding="utf-8")
    return content


def diagnosis_content(diagnosis: "Diagnosis", recorded: Recorded) -> dict[str, Any]:
    """diagnosis.json."""
    return {
        "command": "diagnose",
        "versions": versions(),
        "model": recorded.model.name,
        "sources": [[str(path), digest] for path, digest in recorded.bags],
        **diagnosis.verdict.to_json(),
    }
