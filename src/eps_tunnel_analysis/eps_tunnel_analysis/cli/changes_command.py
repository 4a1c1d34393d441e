# SPDX-License-Identifier: Apache-2.0
"""changes: what changed on a rig between two dates."""

import argparse
import csv
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from eps_tunnel_analysis.cli.arguments import (
    add_known_argument,
    add_model_arguments,
    add_reading_arguments,
    add_threads_argument,
    reading_of,
)
from eps_tunnel_analysis.outputs import circumstances, json_text, new_folder, refuse_existing
from eps_tunnel_analysis.terminal import console, print_notes, rollout_progress, table
from labyrinth_sim.errors import InputError

if TYPE_CHECKING:
    from eps_tunnel_analysis.inputs import Recorded
    from eps_tunnel_analysis.values.changes import DateOfRig

NAME = "changes"
HELP = "Names which value or effect of a rig changed between two dates, and by how much."
EPILOG = """\
examples:
  eps-tunnel changes --then march/real_* --now june/real_* --model rig.yaml --out wear
  eps-tunnel changes --then march/* --also april=april/* --also may=may/* --now june/* --model rig.yaml --out wear

Play the same command on every date: an error that the model has on both dates then does not count as a change. The
model's values are fitted to the earlier recordings unless --keep-values is given. Four outcomes: nothing beyond the
rig's own spread, changed (what, by how much), undecided, unknown. Files in --out: changes.json, then.yaml (the model
as fitted), dates.csv, dates.svg."""
THEN, NOW = "then", "now"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--then", nargs="+", metavar="BAG", required=True, type=Path,
                        help="recordings of the earlier date, several trials")  # fmt: skip
    parser.add_argument("--now", nargs="+", metavar="BAG", required=True, type=Path,
                        help="recordings of the later date")  # fmt: skip
    parser.add_argument("--also", nargs="+", metavar="LABEL=BAG", action="append", default=[],
                        help="recordings of a date in between, in order; its name before the first one"
                        )  # fmt: skip
    add_reading_arguments(parser)
    add_model_arguments(parser)
    add_known_argument(parser)
    parser.add_argument("--candidates", nargs="+", metavar="NAME",
                        help="what may have changed: values such as drive.x.p, effects such as backlash (default: all)"
                        )  # fmt: skip
    parser.add_argument("--keep-values", action="store_true",
                        help="the model's values already fit the earlier recordings")  # fmt: skip
    add_threads_argument(parser)
    parser.add_argument("--out", type=Path, metavar="DIR", help="write result, model and picture into a new folder")
    parser.add_argument("--json", action="store_true", help="print the result as JSON, and nothing else, to stdout")


def run(arguments: argparse.Namespace) -> None:
    from eps_tunnel_analysis.diagnose.axis_search import SearchOptions
    from eps_tunnel_analysis.diagnose.progress import RolloutCount
    from eps_tunnel_analysis.values.changes import changes, over_dates

    if arguments.out:
        refuse_existing(arguments.out)
    recorded = {label: _recorded(arguments, bags) for label, bags in _dates(arguments).items()}
    then, now = recorded[THEN], recorded[NOW]
    with rollout_progress() as progress:
        options = SearchOptions(None, arguments.threads, RolloutCount(progress) if progress else None)
        changed = changes(then.model, then.plays, now.plays, arguments.candidates, arguments.keep_values, options)
        watched = changed.named if changed.outcome in ("changed", "undecided") else ()
        dates = over_dates(changed.model, {label: r.plays for label, r in recorded.items()}, watched, run=options)
    content = {
        "command": NAME,
        "model": then.model.name,
        "sources": {label: [[str(path), digest] for path, digest in r.bags] for label, r in recorded.items()},
        "made": [list(fact) for fact in circumstances()],
        **changed.to_json(),
        "dates": [date.to_json() for date in dates],
    }
    if arguments.out:
        from eps_tunnel_analysis.report.values_pictures import dates_picture, save_svg
        from labyrinth_sim.model import save_model

        with new_folder(arguments.out) as folder:
            save_model(changed.model, folder / "then.yaml")
            (folder / "changes.json").write_text(json_text(content), encoding="utf-8")
            _write_csv(folder / "dates.csv", dates)
            save_svg(dates_picture(dates), folder / "dates.svg")
    if arguments.json:
        print(json_text(content), end="")
        return
    out = console()
    out.print(changed.sentence, style="bold", soft_wrap=True, markup=False)
    for value in changed.values:
        out.print(value.sentence, soft_wrap=True, markup=False)
    rows = [(name, f"{p:.1%}", "*" if name in changed.stated else "") for name, p in changed.set.items() if p >= 0.001]
    table(out, "Hypotheses", ("what changed", "probability", "in the stated set"), rows)
    paired, plays = changed.paired
    if paired < plays:
        out.print(f"{plays - paired} of {plays} commands were not played on both dates; for those, a change must stand "
                  "out from the model's error.", soft_wrap=True)  # fmt: skip
    print_notes(out, (*then.notes, *now.notes, *changed.notes))
    if arguments.out:
        out.print(f"Picture: {(arguments.out / 'dates.svg').resolve()}", soft_wrap=True)


def _dates(arguments: argparse.Namespace) -> dict[str, list[Path]]:
    """Label -> bags, in order."""
    dates = {THEN: list(arguments.then)}
    for first, *more in arguments.also:
        label, equals, bag = first.partition("=")
        if not (label and equals and bag):
            raise InputError(f"--also {first}: expected LABEL=BAG, as --also april=bags/april.")
        if label in (*dates, NOW):
            raise InputError(f"--also {first}: the label '{label}' is taken; name every date differently.")
        dates[label] = [Path(bag), *map(Path, more)]
    return {**dates, NOW: list(arguments.now)}


def _recorded(arguments: argparse.Namespace, bags: Sequence[Path]) -> "Recorded":
    from eps_tunnel_analysis.inputs import load_recorded

    rules = [r for r in arguments.known or () if any(_matches(r, bag) for bag in bags)]
    return load_recorded(
        arguments.model, bags, reading_of(arguments), effects=arguments.effects, known=rules, efforts=True
    )


def _matches(rule: str, bag: Path) -> bool:
    from fnmatch import fnmatch

    from eps_tunnel_analysis.inputs import bags

    return any(fnmatch(str(path), rule.partition(":")[0]) for path in bags([bag]))


def _write_csv(path: Path, dates: "Sequence[DateOfRig]") -> None:
    names = list(dict.fromkeys(v.name for date in dates for v in date.values))
    ks = list(dates[0].alikeness)
    with path.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        shares = [f"alikeness_k{k:g}{of}" for k in ks for of in ("", "_rig")]
        writer.writerow(["date", *shares, *(f"{n}{w}" for n in names for w in ("", "_half"))])
        for date in dates:
            known: Mapping[str, tuple[float, float]] = {v.name: (v.now, v.half_width) for v in date.values}
            row = [cell for n in names for cell in known.get(n, ("", ""))]
            writer.writerow([date.label, *(of[k] for k in ks for of in (date.alikeness, date.itself)), *row])
