# SPDX-License-Identifier: Apache-2.0
"""What ROS 2's tools need of a package: markers, entry points, data files, tests; also of a package on its own."""

import ast
import configparser
import os
import re
import shutil
import site
import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

import labyrinth_hw.config
import labyrinth_sim.config

ROOT = Path(__file__).resolve().parents[1]
CONFIG = ROOT / "config"
PYTHON_PACKAGES = ("labyrinth_sim", "labyrinth_hw", "eps_tunnel_analysis")
QUICK = {
    "labyrinth_sim": "test/test_config.py",
    "labyrinth_hw": "test/test_safety.py",
    "eps_tunnel_analysis": "test/test_tunnel.py",
}
LAUNCH_FILES = sorted((ROOT / "src").glob("*/launch/*.launch.py"))


def entry_points(package: str) -> dict[str, str]:
    """Executable -> module:function, from setup.py."""
    for node in ast.walk(ast.parse((ROOT / "src" / package / "setup.py").read_text())):
        if isinstance(node, ast.Dict):
            for key, value in zip(node.keys, node.values, strict=True):
                if isinstance(key, ast.Constant) and key.value == "console_scripts":
                    return dict(line.split(" = ") for line in ast.literal_eval(value))
    raise AssertionError(f"{package}/setup.py has no console_scripts")


@pytest.mark.parametrize("package", PYTHON_PACKAGES)
def test_ros_finds_the_package(package: str) -> None:
    folder = ROOT / "src" / package
    manifest = ET.parse(folder / "package.xml").getroot()
    assert manifest.findtext("name") == package
    assert manifest.findtext("license") == "Apache-2.0"
    assert manifest.findtext("export/build_type") == "ament_python"
    assert (folder / "resource" / package).is_file()
    config = configparser.ConfigParser()
    config.read(folder / "setup.cfg")
    assert config["install"]["install_scripts"] == config["develop"]["script_dir"] == f"$base/lib/{package}"


def calls(file: Path, name: str) -> list[dict[str, str]]:
    """Keywords with literal text, of every call of `name` in a file."""
    return [
        {k.arg: k.value.value for k in node.keywords if k.arg and isinstance(k.value, ast.Constant)}
        for node in ast.walk(ast.parse(file.read_text()))
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == name
    ]


@pytest.mark.parametrize("file", LAUNCH_FILES, ids=lambda file: file.name)
def test_launch_files_start_executables_that_exist(file: Path) -> None:
    compile(file.read_text(), str(file), "exec")
    names = {node.name for node in ast.parse(file.read_text()).body if isinstance(node, ast.FunctionDef)}
    assert "generate_launch_description" in names
    started = [(n["package"], n.get("executable")) for n in [*calls(file, "Node"), *calls(file, "LifecycleNode")]]
    own = file.parents[1].name  # a file's helper `node(EXECUTABLE, ...)` starts those of its own package
    helped = [
        (own, call.args[0].value)
        for call in ast.walk(ast.parse(file.read_text()))
        if isinstance(call, ast.Call) and isinstance(call.func, ast.Name) and call.func.id == "node"
        if isinstance(call.args[0], ast.Constant)
    ]
    assert [e for _, e in started if e] or helped
    for package, executable in [*started, *helped]:
        assert executable is None or executable in entry_points(package)


def files(folder: Path) -> set[str]:
    """Every file under a folder, by its path from there."""
    found = (file.relative_to(folder) for file in folder.rglob("*") if file.is_file())
    return {str(file) for file in found if "__pycache__" not in file.parts}


def test_config_shows_the_files_of_all_packages() -> None:
    shown = {f"{entry.name}/{file}" for entry in CONFIG.iterdir() if entry.is_dir() for file in files(entry.resolve())}
    shown |= {entry.name for entry in CONFIG.iterdir() if entry.is_file()}
    assert all(entry.is_symlink() for entry in CONFIG.iterdir()), "config/ holds links into src/*/config/ only"
    assert shown == {file for package in PYTHON_PACKAGES for file in files(ROOT / "src" / package / "config")}


@pytest.mark.parametrize("package", PYTHON_PACKAGES)
def test_the_workspace_installs_its_configuration(package: str) -> None:
    share = Path(pytest.importorskip("ament_index_python").get_package_share_directory(package))
    assert files(share / "config") == files(ROOT / "src" / package / "config"), "run `make setup`"


def colcon(folder: Path, package: str, verb: str, *options: str) -> str:
    """Output of `colcon VERB` in a folder; it sees the workspace as installed, but for the package itself."""
    installed = str(ROOT / "install" / package)
    done = subprocess.run(
        [sys.executable, "-m", "colcon", verb, *options],
        cwd=folder,
        env={
            name: os.pathsep.join(part for part in value.split(os.pathsep) if not part.startswith(installed))
            for name, value in os.environ.items()
            if not name.startswith("PYTEST")
        },
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(
    scope="module",
    params=[pytest.param(p, marks=[pytest.mark.study] * (p != "labyrinth_hw")) for p in PYTHON_PACKAGES],
)
def alone(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A package built from a copy of its folder, in which nothing else of the repository lies."""
    package, folder = request.param, tmp_path_factory.mktemp("alone")
    left_out = shutil.ignore_patterns("__pycache__", "*.egg-info", ".*_cache")
    shutil.copytree(ROOT / "src" / package, folder / package, symlinks=True, ignore=left_out)
    colcon(folder, package, "build", "--base-paths", package)
    return folder / package


def test_a_package_alone_installs_its_configuration(alone: Path) -> None:
    share = alone.parent / "install" / alone.name / "share" / alone.name
    assert files(share / "config") == files(alone / "config")
    assert files(share / "launch") == files(alone / "launch")


def number_run(summary: str) -> int:
    """How many tests `colcon test-result` counts, none of which failed."""
    match = re.search(r"Summary: (\d+) tests, 0 errors, 0 failures", summary)
    assert match is not None, summary
    return int(match[1])


def test_colcon_test_runs_the_tests_of_a_package_alone(alone: Path) -> None:
    # One file is enough to show that they are run; all of them must at least be found.
    def test(*options: str) -> None:
        given = ("--base-paths", alone.name, "--return-code-on-test-failure", "--pytest-args", *options)
        colcon(alone.parent, alone.name, "test", *given)

    test(QUICK[alone.name])
    assert number_run(colcon(alone.parent, alone.name, "test-result", "--all")) >= 5
    test(" --collect-only", " -qq")
    log = (alone.parent / "log" / "latest_test" / alone.name / "stdout.log").read_text(encoding="utf-8")
    collected = {line.split(":")[0] for line in log.splitlines() if line.startswith("test/")}
    assert collected == {f"test/{file.name}" for file in (alone / "test").glob("test_*.py")}


@pytest.mark.realtime
def test_colcon_test_runs_the_tests_of_the_messages() -> None:
    package = "labyrinth_msgs"
    if not (ROOT / "build" / package / "CTestTestfile.cmake").is_file():
        pytest.skip("the workspace was not built here: make setup")
    # Where it was built, for to generate the code once more takes a minute; nothing outside its folder goes into it.
    assert ".." not in (ROOT / "src" / package / "CMakeLists.txt").read_text(encoding="utf-8")
    colcon(ROOT, package, "test", "--base-paths", f"src/{package}", "--return-code-on-test-failure")
    assert number_run(colcon(ROOT, package, "test-result", "--all", "--test-result-base", f"build/{package}")) >= 5


@pytest.mark.parametrize("package", PYTHON_PACKAGES)
def test_every_executable_has_its_function(package: str) -> None:
    for name, target in entry_points(package).items():
        module, function = target.split(":")
        file = ROOT / "src" / package / (module.replace(".", "/") + ".py")
        assert file.is_file(), f"{package} {name}: {module} does not exist"
        defined = {node.name for node in ast.walk(ast.parse(file.read_text())) if isinstance(node, ast.FunctionDef)}
        brought = {
            alias.asname or alias.name
            for node in ast.walk(ast.parse(file.read_text()))
            if isinstance(node, ast.ImportFrom)
            for alias in node.names
        }
        assert function in defined | brought, f"{package} {name}: {module} has no {function}"


def test_hardware_files_are_looked_for_where_rigs_are(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for place in ("named", "sourced/share/one/config", "prefix/share/one/config", "user/share/one/config"):
        (tmp_path / place / "hw").mkdir(parents=True)
        (tmp_path / place / "testbed").mkdir()
    monkeypatch.setenv(labyrinth_sim.config.VARIABLE, str(tmp_path / "named"))
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path / "sourced"))
    monkeypatch.setattr(sys, "prefix", str(tmp_path / "prefix"))
    monkeypatch.setattr(site, "getuserbase", lambda: str(tmp_path / "user"))
    for kind in ("hw", "testbed"):
        assert labyrinth_hw.config.folders(kind) == labyrinth_sim.config.folders(kind)
        assert tmp_path / "user" / "share" / "one" / "config" / kind in labyrinth_hw.config.folders(kind)
