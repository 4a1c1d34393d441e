# SPDX-License-Identifier: Apache-2.0
import os
import sys
from pathlib import Path

from setuptools import find_packages, setup

HERE = Path(__file__).resolve().parent
# colcon puts programs into lib/PACKAGE, where `ros2 run` looks (setup.cfg). pip would put them on PATH, where a name
# such as `urdf` is not ours to take.
BY_PIP = bool({"bdist_wheel", "dist_info", "editable_wheel"} & set(sys.argv))
PROGRAMS = {
    "console_scripts": [
        "sim_node = labyrinth_sim.nodes.sim_node:main",
        "urdf = labyrinth_sim.urdf:main",
    ],
}


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
    name="labyrinth_sim",
    version="0.1.0",
    packages=find_packages(include=["labyrinth_sim", "labyrinth_sim.*"]),
    package_data={"": ["*.html", "*.css", "*.js", "*.xml", "*.j2", "*.json", "py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/labyrinth_sim"]),
        ("share/labyrinth_sim", ["package.xml"]),
        *tree(HERE / "launch", "share/labyrinth_sim/launch"),
        *tree(HERE / "config", "share/labyrinth_sim/config"),
    ],
    install_requires=["mujoco", "numba", "numpy", "opencv-python-headless", "pydantic", "pyyaml", "scipy"],
    # This makes `colcon test` run pytest.
    extras_require={"test": ["hypothesis", "pytest"]},
    python_requires=">=3.11",
    zip_safe=False,
    maintainer="The maintainers",
    maintainer_email="maintainers@users.noreply.github.com",
    description="Rigs, models and physical effects as data, simulated in MuJoCo one by one or in batches.",
    license="Apache-2.0",
    entry_points={} if BY_PIP else PROGRAMS,
)
