# SPDX-License-Identifier: Apache-2.0
import os
import sys
from pathlib import Path

from setuptools import find_packages, setup

HERE = Path(__file__).resolve().parent
# colcon puts programs into lib/PACKAGE, where `ros2 run` looks (setup.cfg). pip would put them on PATH, where a name
# such as `demo` is not ours to take.
BY_PIP = bool({"bdist_wheel", "dist_info", "editable_wheel"} & set(sys.argv))
PROGRAMS = {
    "console_scripts": [
        "player = eps_tunnel_analysis.nodes.player:main",
        "analysis_node = eps_tunnel_analysis.nodes.analysis_node:main",
        "calibrate_node = eps_tunnel_analysis.nodes.calibrate_node:main",
        "monitor = eps_tunnel_analysis.nodes.monitor_start:main",
        "demo = eps_tunnel_analysis.nodes.demo:main",
        "eps_tunnel = eps_tunnel_analysis.cli.main:main",
    ],
}
ENTRY_POINTS = {"console_scripts": ["eps-tunnel = eps_tunnel_analysis.cli.main:main"]} if BY_PIP else PROGRAMS


def relative(path: Path) -> str:
    """A source path as colcon and pip both accept it, whichever folder they run this file in."""
    return os.path.relpath(path, Path.cwd())


def tree(folder: Path, target: str) -> list[tuple[str, list[str]]]:
    """Every file under `folder` as data files under `target`, folder by folder."""
    return [
        (
            str(Path(target) / parent.relative_to(folder)),
            sorted(relative(file) for file in parent.iterdir() if file.is_file()),
        )
        for parent in (folder, *sorted(path for path in folder.rglob("*") if path.is_dir()))
        if folder.is_dir() and parent.name != "__pycache__"
    ]


setup(
    name="eps_tunnel_analysis",
    version="0.1.0",
    packages=find_packages(include=["eps_tunnel_analysis", "eps_tunnel_analysis.*"]),
    package_data={
        "": ["*.html", "*.css", "*.js", "*.xml", "*.j2", "*.json", "py.typed"],
        "eps_tunnel_analysis.monitor": ["static/*", "static/vendor/*"],
    },
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/eps_tunnel_analysis"]),
        ("share/eps_tunnel_analysis", ["package.xml"]),
        *tree(HERE / "launch", "share/eps_tunnel_analysis/launch"),
        *tree(HERE / "config", "share/eps_tunnel_analysis/config"),
        # colcon puts an installed bin/ on PATH, so `eps-tunnel` needs no `ros2 run`.
        *([] if BY_PIP else [("bin", [relative(HERE / "scripts" / "eps-tunnel")])]),
    ],
    install_requires=[
        "argcomplete",
        "cma",
        "jinja2",
        "labyrinth_sim",
        "lz4",
        "matplotlib",
        "mcap",
        "mujoco",
        "numpy",
        "pydantic",
        "pyyaml",
        "rich",
        "rosbags",
        "scipy",
        "tornado",
        "tqdm",
        "zstandard",
    ],
    # This makes `colcon test` run pytest.
    extras_require={"test": ["hypothesis", "pytest"]},
    python_requires=">=3.11",
    zip_safe=False,
    maintainer="The maintainers",
    maintainer_email="maintainers@users.noreply.github.com",
    description="How far a simulation is from a real rig, where, and which physical effect the model lacks.",
    license="Apache-2.0",
    entry_points=ENTRY_POINTS,
)
