# SPDX-License-Identifier: Apache-2.0
"""What `ros2 run` and `ros2 launch` need: markers, entry points, data files.

Launch itself is not on PyPI, so launch files are read here, not run.
"""

import ast
import configparser
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PYTHON_PACKAGES = ("labyrinth_sim", "labyrinth_hw", "eps_tunnel_analysis")
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
    for node in calls(file, "Node"):
        assert node["executable"] in entry_points(node["package"])


def test_the_workspace_installs_its_configuration() -> None:
    index = pytest.importorskip("ament_index_python")
    ours = [("eps_tunnel_analysis", kind) for kind in ("nodes", "sequences")]
    for package, kind in (("labyrinth_sim", "rigs"), ("labyrinth_sim", "models"), *ours):
        share = Path(index.get_package_share_directory(package)) / "config" / kind
        installed = {file.relative_to(share) for file in share.rglob("*") if file.is_file()}
        kept = {
            file.relative_to(ROOT / "config" / kind) for file in (ROOT / "config" / kind).rglob("*") if file.is_file()
        }
        assert kept == installed, f"run `make setup`: {share} does not hold what config/{kind} holds"


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
