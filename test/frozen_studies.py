# SPDX-License-Identifier: Apache-2.0
"""Three small studies whose results are frozen in test/frozen, so that a change of the code shows what it changes.

    python test/frozen_studies.py             compare with what is frozen, and list every difference
    python test/frozen_studies.py --write     freeze the present results; then look at `git diff test/frozen`

Everything but the making of the recordings goes through the command line with --json. What differs from call to call is
left out or masked: seconds, dates, folders, versions, hashes of files.
"""

import argparse
import json
import math
import re
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent))
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "src" / "eps_tunnel_analysis" / "test"))

from command_line import eps_tunnel
from frozen_recordings import called, elbow_friction, late_horn, unbalanced_labyrinth

FROZEN = Path(__file__).parent / "frozen"
ABSENT = "absent"


@dataclass(frozen=True)
class Tolerance:
    """How far apart two numbers may be: by `relative` of the larger, or by `smallest` in the number's own SI unit."""

    relative: float
    smallest: float

    def same(self, a: float, b: float) -> bool:
        return math.isclose(a, b, rel_tol=self.relative, abs_tol=self.smallest)


LONG = 0.4  # s outside a tunnel; shorter times come and go with the last digits of a fit
# Command and beginning of the key; the first that fits.
TOLERANCES = {
    ("compare", ""): Tolerance(1e-6, 1e-12),  # formulas without a search
    ("calibrate", ""): Tolerance(1e-3, 1e-9),  # a search ends a little elsewhere where sums are ordered otherwise
    ("diagnose", "alikeness"): Tolerance(0.05, 0.02),  # models refitted to part of the samples
    ("diagnose", "seconds_outside"): Tolerance(0.05, 0.1),
    ("diagnose", ""): Tolerance(0.05, 1e-5),
    ("effects", ""): Tolerance(1e-12, 0.0),  # as declared
}


@dataclass(frozen=True)
class Study:
    """Recordings, a model, and how the commands are called.

    Attributes:
        record: makes the bags in a folder, by group; "all" are fitted.
        compared, diagnosed: the groups for these commands.
        calibrate: further words for calibrate.
        candidates: that diagnose considers.
        fitted: diagnose the calibrated model and not the given one.
    """

    record: Callable[[Path], dict[str, list[Path]]]
    model: str
    calibrate: str
    candidates: str
    compared: str = "all"
    diagnosed: str = "all"
    fitted: bool = False


STUDIES = {
    "late_horn": Study(
        late_horn,
        "horn",
        "--method es --generations 3 --fitness srg --free drive.horn.damping",
        "coulomb_friction viscous_friction command_delay",
    ),
    "unbalanced_labyrinth": Study(
        unbalanced_labyrinth,
        "labyrinth",
        "--budget 150 --free drive.*.p drive.*.delay",
        "gravity_load return_spring",
        fitted=True,
    ),
    "elbow_friction": Study(
        elbow_friction,
        "two_link_arm",
        "--hold-out 1 --budget 150 --free drive.*.stiffness drive.*.damping",
        "coulomb_friction viscous_friction",
        compared="both",
        diagnosed="elbow",
    ),
}
COMMANDS = ("compare", "calibrate", "diagnose")
FILES = ("effects", *(f"{study}_{command}" for study in STUDIES for command in COMMANDS))


class Laboratory:
    """Runs the studies, each command once, in a folder of its own.

    Args:
        folder: for bags, models and reports.
        threads: of the simulation; the results must not depend on it.
    """

    def __init__(self, folder: Path, threads: int = 1) -> None:
        self._folder, self._threads = folder, ["--threads", threads]
        self._bags = cache(self._record)
        self._calibrated = cache(self._calibrate)

    def result(self, name: str) -> Any:
        """The present result, reduced to what is frozen; `name` is one of FILES."""
        if name == "effects":
            return declared(json.loads(called(eps_tunnel("effects", "--json"))))
        study, _, command = name.rpartition("_")
        content = {"compare": self._compare, "calibrate": self._calibrated, "diagnose": self._diagnose}[command](study)
        return masked({"compare": compared, "calibrate": calibrated, "diagnose": diagnosed}[command](content))

    def _record(self, name: str) -> dict[str, list[Path]]:
        folder = self._folder / name
        folder.mkdir()
        return STUDIES[name].record(folder)

    def _compare(self, name: str) -> Any:
        study = STUDIES[name]
        return self._call("compare", "--real", *self._bags(name)[study.compared], "--model", study.model)

    def _calibrate(self, name: str) -> Any:
        study = STUDIES[name]
        return self._call("calibrate", "--real", *self._bags(name)["all"], "--model", study.model, *self._threads,
                          "--out", self._model(name), "--progress", "none", *study.calibrate.split())  # fmt: skip

    def _diagnose(self, name: str) -> Any:
        study = STUDIES[name]
        if study.fitted:
            self._calibrated(name)
        return self._call("diagnose", "--real", *self._bags(name)[study.diagnosed], *self._threads,
                          "--model", self._model(name) if study.fitted else study.model,
                          "--out", self._folder / f"{name}_why", "--candidates", *study.candidates.split())  # fmt: skip

    def _model(self, name: str) -> Path:
        return self._folder / f"{name}_fitted.yaml"

    @staticmethod
    def _call(*words: object) -> Any:
        return json.loads(called(eps_tunnel(*words, "--json")))


def compared(content: Any) -> Any:
    """Everything but versions and the hash of the model's file, which is part of its entry among the sources."""
    sources = [entry for entry in content["sources"] if entry[0] != "model file"]
    return {**without(content, "versions"), "sources": sources}


def calibrated(content: Any) -> Any:
    """Values, intervals, scores and words; not the history of the search, nor what differs from call to call."""
    fits = [without(fit, "seconds", "history") for fit in content["fits"]]
    left_out = ("out", "called", "date", "versions", "seconds", "bags")
    return {**without(content, *left_out), "model": without(content["model"], "file"), "fits": fits}


def diagnosed(content: Any) -> Any:
    """Verdict, effects, the signals that are outside their tunnels for LONG (s), and the errors of the three models."""
    outside: dict[str, float] = {}
    for span in content["where"]:
        outside[span["signal"]] = outside.get(span["signal"], 0.0) + span["end"] - span["start"]
    kept = ["verdict", "effects"]
    kept += [f"{what}_{of}" for what in ("error", "held_out", "alikeness") for of in ("as_given", "before", "after")]
    outside = {signal: seconds for signal, seconds in outside.items() if seconds >= LONG}
    return {**{key: content[key] for key in kept}, "seconds_outside": outside}


def declared(content: Any) -> Any:
    """Each effect's stage, place and parameters; not its sentences."""
    return {
        effect["name"]: {
            **{key: effect[key] for key in ("stage", "where", "confused_with")},
            "parameters": {p["name"]: without(p, "name", "why") for p in effect["parameters"]},
        }
        for effect in content
    }


def without(content: dict[str, Any], *keys: str) -> dict[str, Any]:
    missing = set(keys) - content.keys()
    assert not missing, f"expected {sorted(missing)} among {list(content)}"
    return {key: value for key, value in content.items() if key not in keys}


def masked(content: Any) -> Any:
    """The same without folders and hashes of files."""
    if isinstance(content, dict):
        return {key: masked(value) for key, value in content.items()}
    if isinstance(content, list):
        return [masked(value) for value in content]
    if isinstance(content, str):
        return re.sub(r"SHA-256 \w+", "SHA-256 ...", re.sub(r"/(?:[^/\s]+/)+", "", content))
    return content


def differences(name: str, frozen: Any, now: Any) -> list[str]:
    """One line for each key whose value is not the same, with both."""
    before, after = dict(flat(frozen)), dict(flat(now))
    pairs = {key: (before.get(key, ABSENT), after.get(key, ABSENT)) for key in (*before, *after)}
    return [
        f"{key}: frozen {a!r}, now {b!r}" for key, (a, b) in pairs.items() if not same(a, b, tolerance_of(name, key))
    ]


def tolerance_of(name: str, key: str) -> Tolerance:
    command = name.rpartition("_")[2]
    return next(t for (of, start), t in TOLERANCES.items() if of == command and key.startswith(start))


def same(a: Any, b: Any, tolerance: Tolerance) -> bool:
    if type(a) is float or type(b) is float:
        numbers = isinstance(a, int | float) and isinstance(b, int | float)
        return numbers and tolerance.same(a, b)
    return bool(a == b and type(a) is type(b))


def flat(content: Any, key: str = "") -> Iterator[tuple[str, Any]]:
    """Every value with the path that leads to it, as `errors[0].rms`; an empty list or dict is a value too."""
    if isinstance(content, dict) and content:
        for name, value in content.items():
            yield from flat(value, f"{key}.{name}" if key else name)
    elif isinstance(content, list) and content:
        for number, value in enumerate(content):
            yield from flat(value, f"{key}[{number}]")
    else:
        yield key, content


def frozen(name: str) -> Any:
    """What was frozen of one of FILES."""
    return json.loads((FROZEN / f"{name}.json").read_text(encoding="utf-8"))


def main(words: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(FILES)} (default: all)")
    parser.add_argument("--write", action="store_true", help="freeze the present results")
    parser.add_argument("--threads", type=int, default=1, metavar="N", help="of the simulation (default: %(default)s)")
    arguments = parser.parse_args(words)
    unknown = set(arguments.names) - set(FILES)
    if unknown:
        parser.error(f"unknown: {', '.join(sorted(unknown))}; expected some of {', '.join(FILES)}")
    found = 0
    with tempfile.TemporaryDirectory() as folder:
        laboratory = Laboratory(Path(folder), arguments.threads)
        for name in arguments.names or FILES:
            now = laboratory.result(name)
            if arguments.write:
                FROZEN.mkdir(exist_ok=True)
                text = json.dumps(now, indent=1, ensure_ascii=False, allow_nan=False)
                (FROZEN / f"{name}.json").write_text(text + "\n", encoding="utf-8")
                continue
            lines = differences(name, frozen(name), now)
            found += len(lines)
            print(f"{name}: {len(lines) or 'no'} differences", *lines, sep="\n  ")
    return int(found > 0)


if __name__ == "__main__":
    sys.exit(main())
