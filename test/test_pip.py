# SPDX-License-Identifier: Apache-2.0
"""The model and the analysis by pip alone, in a virtual environment without ROS: what is on the path, that it works.

Libraries are those of the environment that runs the tests, so nothing is fetched; every import of ROS is refused.
"""

import json
import os
import shutil
import subprocess
import sys
import venv
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("labyrinth_sim", "eps_tunnel_analysis")
LINUX_ONLY = ("fcntl", "grp", "posix", "pty", "pwd", "resource", "termios", "tty")
HOOK = f"""
import sys
class Refused:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in {{"rclpy", "labyrinth_msgs", "ament_index_python", "launch"}}:
            raise ImportError(name + " is not here")
        if name in {LINUX_ONLY!r} and (caller := sys._getframe(1)):
            while caller and "importlib" in caller.f_code.co_filename:
                caller = caller.f_back
            if caller and caller.f_globals.get("__name__", "").split(".")[0] in {PACKAGES!r}:
                raise ImportError(name + " is only on Linux")
sys.meta_path.insert(0, Refused())
"""
EVERYTHING = """
import importlib, pkgutil, sys, labyrinth_sim, eps_tunnel_analysis
for package in (labyrinth_sim, eps_tunnel_analysis):
    assert "site-packages" in package.__file__, package.__file__
    for module in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
        if ".nodes" not in module.name and not module.name.endswith("__main__"):
            importlib.import_module(module.name)
"""
STUDY = """
import eps_tunnel_analysis as eps
gap = eps.load("bag", model="horn").compare()
print(gap.comparison.real.count, eps.load_model("horn").path)
"""


@pytest.fixture(scope="module")
def environment(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A virtual environment with copies of both packages, built and installed by pip."""
    folder = tmp_path_factory.mktemp("pip")
    left_out = shutil.ignore_patterns("__pycache__", "*.egg-info", "build", "test")
    for package in PACKAGES:
        shutil.copytree(ROOT / "src" / package, folder / package, ignore=left_out)
    venv.create(folder / "venv", with_pip=False)
    pip = [sys.executable, "-m", "pip", "--python", str(program(folder / "venv", "python")), "install", "--no-deps"]
    given = ["--no-index", "--no-build-isolation", "--no-input", *(str(folder / package) for package in PACKAGES)]
    site = Path(run(folder / "venv", "python", "-c", "import sysconfig; print(sysconfig.get_path('purelib'))").strip())
    # setuptools and the libraries; a sourced ROS may hold some of them.
    libraries = [
        path for path in sys.path if path.endswith("-packages") and not Path(path).is_relative_to(ROOT / "install")
    ]
    (site / "libraries.pth").write_text("\n".join(libraries) + "\n", encoding="utf-8")
    done = subprocess.run([*pip, *given], env=plain(), capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    (site / "refused.py").write_text(HOOK, encoding="utf-8")
    (site / "aaa.pth").write_text("import refused\n", encoding="utf-8")
    return folder / "venv"


def plain() -> dict[str, str]:
    """The environment's variables without those that lead to ROS or to the source tree."""
    ours = ("PYTHON", "AMENT", "ROS", "COLCON", "CMAKE", "LD_LIBRARY", "VIRTUAL_ENV", "EPS_TUNNEL")
    return {name: value for name, value in os.environ.items() if not name.startswith(ours)}


def program(environment: Path, name: str) -> Path:
    return environment / ("Scripts" if os.name == "nt" else "bin") / name


def run(environment: Path, name: str, *arguments: object, folder: Path | None = None) -> str:
    done = subprocess.run(
        [str(program(environment, name)), *map(str, arguments)], cwd=folder or environment, env=plain(),
        capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_only_the_command_is_on_the_path(environment: Path) -> None:
    ours = {file.name for file in program(environment, "").iterdir()}
    assert {name for name in ours if not name.lower().startswith(("activate", "python"))} == {"eps-tunnel"}


@pytest.mark.study
def test_everything_but_nodes_imports_without_ros_and_without_linux(environment: Path) -> None:
    with pytest.raises(AssertionError, match="rclpy is not here"):
        run(environment, "python", "-c", "import rclpy")
    run(environment, "python", "-c", EVERYTHING)


def test_the_command_compares_bags_from_tables(environment: Path, tmp_path: Path) -> None:
    rows = "\n".join(f"{i / 100:.2f},{0.1 * (i > 20)},{0.1 * (i > 25)}" for i in range(100))
    (tmp_path / "log.csv").write_text(f"t,u,q\n{rows}\n", encoding="utf-8")
    given = ("--time", "t", "--command", "joint=u", "--position", "joint=q", "--out", "bag")
    run(environment, "eps-tunnel", "import-csv", "log.csv", *given, folder=tmp_path)
    told = run(environment, "eps-tunnel", "compare", "--real", "bag", "--model", "horn", "--json", folder=tmp_path)
    assert json.loads(told)["trials_real"] == 1
    count, path = run(environment, "python", "-c", STUDY, folder=tmp_path).split(maxsplit=1)
    assert count == "1"
    assert Path(path.strip()).is_relative_to(environment)
