# SPDX-License-Identifier: Apache-2.0
"""Writes what a run of benchmarks/diagnosis.py measured into docs/diagnosis.md, between its two marks.

python benchmarks/study_table.py out.json
"""

import argparse
import itertools
import json
from collections import defaultdict
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from diagnosis import STRONG, figures, right

PAGE = Path(__file__).resolve().parents[1] / "docs" / "diagnosis.md"
BEGIN, END = "<!-- study: written by benchmarks/study_table.py -->", "<!-- end of the study -->"
KEYS = {  # key: what it means, the bar, the cases that speak to it
    "top1_strong": ("named right, single effects that show at over 3 times the floor", "0.95",
                    lambda r: r["kind"] == "single" and r["shows"] > STRONG),
    "top1_all": ("named right, all single effects; undecided with the truth in a set of two counts half", "0.85",
                 lambda r: r["kind"] == "single"),
    "pair_both": ("both named, pairs of strong effects", "0.80", lambda r: r["kind"] == "pair"),
    "false_alarm": ("an effect named where nothing is missing", "≤ 0.02", lambda r: r["kind"] == "none"),
    "unknown_found": ("outside the library: called unknown, or a set stating it", "0.90",
                      lambda r: r["kind"] == "outside"),
    "coverage_90": ("the truth is in the stated set", "0.87 to 0.95", lambda r: True),
    "drop_vs_oracle": ("fall of the held-out error over that with the true form, median", "0.9",
                       lambda r: "oracle" in r),
    "decided_after_experiment": ("undecided, then right after the proposed experiment", "0.9",
                                 lambda r: "after_experiment" in r),
}  # fmt: skip
LEVELS = (0.0, 0.5, 0.7, 0.9, 0.99, 0.999, 1.0 + 1e-9)
Record = dict[str, Any]


def page(content: dict[str, Any]) -> str:
    """The part of the page, in Markdown."""
    records: list[Record] = content["cases"]
    kinds = {kind: sum(r["kind"] == kind for r in records) for kind in ("single", "pair", "none", "outside")}
    lines = [
        f"{len(records)} cases of {content['date']}, seeds {records[0]['seed']} to {records[-1]['seed']}: "
        f"{kinds['single']} single effects, {kinds['pair']} pairs of strong ones, {kinds['none']} with nothing hidden,",
        f"{kinds['outside']} outside the library. In brackets: how many cases speak to a figure.",
        "",
        f"    python benchmarks/diagnosis.py --cases {len(records)} --seed {content['seed']} "
        f"--workers {content['workers']} --threads {content['threads']} --json out.json",
        "",
        "| key | means | measured | bar |",
        "|---|---|---|---|",
    ]
    measured = figures(records)
    for key, (means, bar, speaks) in KEYS.items():
        value = measured[key]
        told = "–" if value is None else f"{value:.3f}"
        lines.append(f"| `{key}` | {means} | {told} ({sum(map(speaks, records))}) | {bar} |")
    seconds = measured["median_seconds"]
    if seconds is not None:
        beside = "alone" if content["workers"] == 1 else f"{content['workers']} side by side"
        threads = f"{content['threads']} thread{'s' * (content['threads'] > 1)}"
        means = f"one diagnosis, whole library, both axes, on {threads}, {beside}, s"
        lines.append(f"| `median_seconds` | {means} | {seconds:.0f} ({len(records)}) | 60 on 2 cores |")
    lines += ["", *_by_effect(records), "", *_reliability(records), "", *_misses(records)]
    return "\n".join(lines) + "\n"


def _by_effect(records: Sequence[Record]) -> Iterator[str]:
    """How often single effects were named right, by strength."""
    cells: dict[tuple[str, str], list[float]] = defaultdict(list)
    for r in (r for r in records if r["kind"] == "single"):
        cells[r["truth"].partition(".")[0], r["strength"]].append(right(r))
    yield "Single effects named right, of how many (undecided between two counts half):"
    yield ""
    yield "| effect | weak | medium | strong |"
    yield "|---|---|---|---|"
    for name in sorted({name for name, _ in cells}):
        found = (cells.get((name, s), []) for s in ("weak", "medium", "strong"))
        yield f"| {name} | " + " | ".join(f"{sum(c):g} of {len(c)}" if c else "" for c in found) + " |"


def _reliability(records: Sequence[Record]) -> Iterator[str]:
    """How often the likeliest hypothesis was true, by the probability it was given."""
    first = [(*max(r["top"].items(), key=lambda item: item[1]), r["truth"]) for r in records]
    yield "How often the likeliest hypothesis was true:"
    yield ""
    yield "| it was given | cases | was true |"
    yield "|---|---|---|"
    for low, high in itertools.pairwise(LEVELS):
        inside = [name == truth for name, p, truth in first if low <= p < high]
        if inside:
            top = f"{min(high, 1.0):.1%}"
            yield f"| {low:.1%} to {top} | {len(inside)} | {sum(inside) / len(inside):.0%} |"


def _misses(records: Sequence[Record]) -> Iterator[str]:
    missed = [r for r in records if not _told(r)]
    yield f"All that was not told right at once, {len(missed)} of {len(records)}:"
    yield ""
    yield "| seed | hidden | base over floor | verdict | stated set | after the experiment |"
    yield "|---|---|---|---|---|---|"
    for r in missed:
        stated = ", ".join(r["stated"][:3]) + (f" and {len(r['stated']) - 3} more" if len(r["stated"]) > 3 else "")
        hidden = f"{'outside' if r['truth'] == 'unknown' else r['truth']} {r['strength']}".strip()
        again = r.get("after_experiment")
        after = (
            "" if again is None else " + ".join(again["effects"]) if again["verdict"] == "effect" else again["verdict"]
        )
        yield f"| {r['seed']} | {hidden} | {r['shows']:.1f} | {r['verdict']} | {stated} | {after} |"


def _told(r: Record) -> bool:
    said = {"complete": "none", "unknown": "unknown", "effect": " + ".join(sorted(r["effects"]))}
    return said.get(r["verdict"]) == r["truth"]


def main() -> None:
    """Rewrites the page's part."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("json", type=Path)
    content = json.loads(parser.parse_args().json.read_text(encoding="utf-8"))
    text = PAGE.read_text(encoding="utf-8")
    before, rest = text.split(BEGIN)
    PAGE.write_text(f"{before}{BEGIN}\n{page(content)}{END}{rest.split(END)[1]}", encoding="utf-8")


if __name__ == "__main__":
    main()
