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
KEYS = {
    "cv2": "python3-opencv",
    "mujoco": "python3-mujoco-pip",
    "rosbags": "python3-rosbags-pip",
    "serial": "python3-serial",
    "yaml": "python3-yaml",
}
PIP_NAMES = {"cv2": "opencv-python-headless", "serial": "pyserial", "yaml": "pyyaml"}
COMES_WITH = {"markupsafe": "jinja2"}
OPTIONAL = {"distributed", "dask", "pyarrow"}  # asked for where they are used, with words on how to get them


def manifest(package: str) -> str:
    return (ROOT / "src" / package / "package.xml").read_text(encoding="utf-8")


def imported(package: str, folder: str = "") -> set[str]:
    """Modules that a folder of a package imports, by default the package itself; without the standard library."""
    found: set[str] = set()
    files = list((ROOT / "src" / package / (folder or package)).rglob("*.py"))
    for file in files:
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                found |= {alias.name.split(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
                found.add(node.module.split(".")[0])
    found = {COMES_WITH.get(module, module) for module in found}
    return (
        found
        - set(sys.stdlib_module_names)
        - {package}
        - OPTIONAL
        - ({file.stem for file in files} if folder else set())
    )


def pinned() -> set[str]:
    lines = (ROOT / "requirements.txt").read_text(encoding="utf-8").splitlines()
    return {re.split(r"[=\[#]", line)[0].strip().lower() for line in lines} - {""}


def without_key(package: str) -> set[str]:
    """What a manifest says that pip installs, for rosdep has no key for it."""
    found = re.search(r"<!-- No rosdep key[^:]*: ([^>]*?)\. -->", manifest(package))
    return set(found[1].split(", ")) if found else set()


@pytest.mark.parametrize("package", PACKAGES[1:])
def test_what_is_imported_is_declared(package: str) -> None:
    declared = {entry.text for entry in ET.fromstring(manifest(package)).iter("exec_depend")}
    by_pip = without_key(package)
    for module in imported(package):
        key = KEYS.get(module, f"python3-{module.replace('_', '-')}")
        assert module in declared or key in declared or module in by_pip, f"{package}/package.xml lacks {module}"
    assert by_pip <= pinned()
    assert not {name for name in by_pip if f"python3-{name}" in declared}


@pytest.mark.parametrize("package", PACKAGES)
def test_what_tests_import_is_declared(package: str) -> None:
    kinds = ("depend", "exec_depend", "test_depend")
    declared = {entry.text for kind in kinds for entry in ET.fromstring(manifest(package)).iter(kind)}
    for module in imported(package, "test"):
        assert {module, KEYS.get(module, f"python3-{module}")} & declared or module in without_key(package), module


def test_what_cmake_finds_is_declared() -> None:
    text = (ROOT / "src" / "labyrinth_msgs" / "CMakeLists.txt").read_text(encoding="utf-8")
    found = set(re.findall(r"find_package\((\w+)", text))
    found |= {name for line in re.findall(r"foreach\(package ([^)]*)\)", text) for name in line.split()}
    declared = {entry.text for entry in ET.fromstring(manifest("labyrinth_msgs")) if entry.tag.endswith("depend")}
    assert len(found) > 5
    assert found <= declared


PIN = re.compile(r"^([\w.-]+)(?:\[[\w,]+\])?==([\w.]+)", re.MULTILINE)


def pins(name: str) -> dict[str, str]:
    """Library -> version that a file of pins, or a lock file, names."""
    return {re.sub(r"[._]", "-", found.lower()): version for found, version in PIN.findall(text_of(name))}


def text_of(name: str) -> str:
    return (ROOT / name).read_text(encoding="utf-8")


def test_the_lock_files_agree_with_the_pins() -> None:
    for file, locks in {
        "requirements.txt": ["requirements.lock"],
        "requirements-ros.txt": ["requirements.lock", "requirements-ros.lock"],
    }.items():
        locked = {name: version for lock in locks for name, version in pins(lock).items()}
        missing = pins(file).items() - locked.items()
        assert not missing, f"{file} was changed: run `make lock`"


def test_the_lock_files_hold_what_the_pins_need_and_nothing_else() -> None:
    both = text_of("requirements.lock") + text_of("requirements-ros.lock")
    entries = re.split(r"^(?=[\w-]+==)", both, flags=re.MULTILINE)[1:]
    wanted = pins("requirements.txt") | pins("requirements-ros.txt")
    assert len(entries) > len(wanted)
    for entry in entries:
        name = entry.split("==")[0]
        assert re.search(r"--hash=sha256:[0-9a-f]{64}", entry), name
        by = set(re.findall(r"^    #(?: via)? +(.+)$", entry, re.MULTILINE))
        assert by, f"{name}: nothing needs it"
        assert not any(line.startswith("-r") for line in by) or name in wanted, f"{name} was dropped: run `make lock`"
    # Which registry the files came from is the business of whoever installs them.
    assert "://" not in both
    assert not re.search(r"^\s*-", both.replace("    --hash", ""), re.MULTILINE)


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
    for point in ("1.i", "2.i", "3.iii", "3.iv", "4.i", "6.i"):  # what REP-2004 requires or recommends at level 4
        assert f"\n- {point}, re" in declaration, point
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
