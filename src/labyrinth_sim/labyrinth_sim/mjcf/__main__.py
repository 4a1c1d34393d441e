# SPDX-License-Identifier: Apache-2.0
"""Writes the labyrinth's MJCF files from its geometry."""

import argparse
import sys
from pathlib import Path

from labyrinth_sim.errors import InputError
from labyrinth_sim.mjcf.geometry import Layout, load_geometry
from labyrinth_sim.mjcf.labyrinth import CYBERRUNNER, labyrinth_xml


def labyrinth_files(layouts: dict[str, Layout]) -> dict[str, str]:
    """File name -> MJCF text: one file a layout, the plain board, and the hard one as CyberRunner drives it."""
    files = {f"labyrinth_{name}.xml": labyrinth_xml(layout) for name, layout in layouts.items()}
    files["labyrinth_plain.xml"] = labyrinth_xml(next(iter(layouts.values())), plain=True)
    own = layouts.get("hard", next(iter(layouts.values())))
    for name, plain in (("cyberrunner", False), ("cyberrunner_plain", True)):
        files[f"{name}.xml"] = labyrinth_xml(own, plain, CYBERRUNNER, name)
    return files


def main(arguments: list[str] | None = None) -> int:
    """Command line; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m labyrinth_sim.mjcf", description=__doc__)
    parser.add_argument("geometry", type=Path, help="YAML file of the geometry")
    parser.add_argument("folder", type=Path, help="where the MJCF files go; files of the same name are replaced")
    options = parser.parse_args(arguments)
    try:
        files = labyrinth_files(load_geometry(options.geometry))
    except InputError as error:
        print(error, file=sys.stderr)
        return 2
    options.folder.mkdir(parents=True, exist_ok=True)
    for name, text in files.items():
        (options.folder / name).write_text(text, encoding="utf-8")
        print(options.folder / name)
    return 0


if __name__ == "__main__":
    sys.exit(main())
