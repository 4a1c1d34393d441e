# SPDX-License-Identifier: Apache-2.0
"""What a package says of itself: licence, dependencies, quality, changes."""

import ast
import re
import subprocess
import sys
import xml.etree.ElementTree as ET
from itertools import pairwise
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("labyrinth_msgs", "labyrinth_sim", "labyrinth_hw", "eps_tunnel_analysis")
SPDX = "SPDX-License-Identifier: Apache-2.0"
WITH_LICENCE = {".py", ".c", ".js", ".css", ".html", ".bash", ".yaml"}
# Import -> rosdep key, or ROS package, where the two names differ.
KEYS = {"cv2": "python3-opencv", "serial": "python3-serial", "yaml": "python3-yaml"}
PIP_NAMES = {"cv2": "opencv-python-headless", "serial": "pyserial", "yaml": "pyyaml"}
COMES_WITH = {"markupsafe": "jinja2"}
OPTIONAL = {"distributed", "dask"}  # asked for where they are used, with words on how to get them


def manifest(package: str) -> str:
    return (ROOT / "src" / package / "package.xml").read_text(encoding="utf-8")


def imported(package: str) -> set[str]:
    """Modules that a package imports, without the standard library and itself."""
    found: set[str] = set()
    for file in (ROOT / "src" / package / package).rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                found |= {alias.name.split(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
                found.add(node.module.split(".")[0])
    found = {COMES_WITH.get(module, module) for module in found}
    return found - set(sys.stdlib_module_names) - {package} - OPTIONAL


def pinned() -> set[str]:
    lines = (ROOT / "requirements.txt").read_text(encoding="utf-8").splitlines()
    return {re.split(r"[=\[#]", line)[0].strip().lower() for line in lines} - {""}


@pytest.mark.parametrize("package", PACKAGES[1:])
def test_what_is_imported_is_declared(package: str) -> None:
    declared = {entry.text for entry in ET.fromstring(manifest(package)).iter("exec_depend")}
    without_key = re.search(r"<!-- No rosdep key[^:]*: ([^>]*?)\. -->", manifest(package))
    by_pip = set(without_key[1].split(", ")) if without_key else set()
    for module in imported(package):
        key = KEYS.get(module, f"python3-{module.replace('_', '-')}")
        assert module in declared or key in declared or module in by_pip, f"{package}/package.xml lacks {module}"
    assert by_pip <= pinned()
    assert not {name for name in by_pip if f"python3-{name}" in declared}


@pytest.mark.parametrize("package", PACKAGES[1:])
def test_libraries_are_pinned_and_named_in_setup_py(package: str) -> None:
    setup = (ROOT / "src" / package / "setup.py").read_text(encoding="utf-8")
    declared = {entry.text for entry in ET.fromstring(manifest(package)).iter("exec_depend")}
    for module in imported(package):
        name = PIP_NAMES.get(module, module.replace("_", "-"))
        if name in pinned():
            assert f'"{name}"' in setup, f"{package}/setup.py: install_requires lacks {name}"
        else:
            assert module in declared, f"requirements.txt lacks {name}"


@pytest.mark.parametrize("package", PACKAGES)
def test_every_package_tells_its_quality_and_its_changes(package: str) -> None:
    folder = ROOT / "src" / package
    declaration = (folder / "QUALITY_DECLARATION.md").read_text(encoding="utf-8")
    assert declaration.startswith(f"# Quality declaration of `{package}`")
    for heading in ("Version policy", "Change control", "Documentation", "Testing", "Dependencies", "Platforms"):
        assert f"\n## {heading}\n" in declaration
    bar, title, under, *rest = (folder / "CHANGELOG.rst").read_text(encoding="utf-8").splitlines()
    assert title == f"Changelog for package {package}"
    assert bar == under == "^" * len(title)
    releases = [line for line, below in pairwise(rest) if below and set(below) == {"-"}]
    # Either nothing was released yet, or the newest release is the manifest's version.
    assert releases[0] == "Forthcoming" or releases[0].startswith(
        str(ET.fromstring(manifest(package)).findtext("version"))
    )


def test_sources_carry_their_licence() -> None:
    listed = subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard"], cwd=ROOT, capture_output=True, text=True
    )
    if listed.returncode:
        pytest.skip("not a git checkout, so what belongs to the sources is unknown")
    files = [ROOT / line for line in listed.stdout.splitlines()]
    assert (ROOT / "LICENSE").read_text(encoding="utf-8").split()[:2] == ["Apache", "License"]
    wrong = [
        str(file.relative_to(ROOT))
        for file in files
        if file.is_file() and file.stat().st_size and "vendor" not in file.parts
        if file.suffix in WITH_LICENCE or file.name == "Makefile"
        if SPDX not in "".join(file.read_text(encoding="utf-8").splitlines(keepends=True)[:3])
    ]
    assert not wrong
