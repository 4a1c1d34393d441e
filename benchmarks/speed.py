# SPDX-License-Identifier: Apache-2.0
"""Speed as ratios, each measured in one run: `python benchmarks/speed.py [--json OUT] [--only SECTION ...]`.

A section is a file in benchmarks/sections with a function `measure() -> dict[str, float]`.
"""

import argparse
import importlib.util
import json
import sys
from collections.abc import Callable
from pathlib import Path

SECTIONS = Path(__file__).parent / "sections"


def section(file: Path) -> Callable[[], dict[str, float]]:
    """The `measure` function of a section's file."""
    spec = importlib.util.spec_from_file_location(f"section_{file.stem}", file)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    measure: Callable[[], dict[str, float]] = module.measure
    return measure


def main() -> int:
    """Measures, prints a table, writes the JSON file; exit code 2 for bad arguments."""
    files = {file.stem: file for file in sorted(SECTIONS.glob("[!_]*.py"))}
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path, metavar="OUT", help="file that receives the figures")
    parser.add_argument(
        "--only", nargs="+", choices=files, default=list(files), metavar="SECTION", help=", ".join(files)
    )
    options = parser.parse_args()
    figures: dict[str, float] = {}
    for name in options.only:
        print(f"{name} ...", file=sys.stderr, flush=True)
        figures |= section(files[name])()
    for key, value in figures.items():
        print(f"{key:40s} {value:14.4g}")
    if options.json:
        options.json.parent.mkdir(parents=True, exist_ok=True)
        options.json.write_text(json.dumps(figures, indent=2) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
