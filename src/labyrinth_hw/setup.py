# SPDX-License-Identifier: Apache-2.0
import os
import sys
from pathlib import Path

from setuptools import find_packages, setup

HERE = Path(__file__).resolve().parent
# colcon puts programs into lib/PACKAGE, where `ros2 run` looks (setup.cfg). pip would put them on PATH, where a name
# such as `testbed` is not ours to take.
BY_PIP = bool({"bdist_wheel", "dist_info", "editable_wheel"} & set(sys.argv))
PROGRAMS = {
    "console_scripts": [
        "controller_forwarder = labyrinth_hw.nodes.controller_forwarder:main",
        "hw_node = labyrinth_hw.nodes.hw_node:main",
        "testbed = labyrinth_hw.testbed.command_line:main",
        "calibrate_motors = labyrinth_hw.nodes.calibrate_motors:main",
        "calibrate_camera = labyrinth_hw.nodes.calibrate_camera:main",
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
    name="labyrinth_hw",
    version="0.1.0",
    packages=find_packages(include=["labyrinth_hw", "labyrinth_hw.*"]),
    package_data={"": ["*.html", "*.css", "*.js", "*.xml", "*.j2", "*.json", "py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/labyrinth_hw"]),
        ("share/labyrinth_hw", ["package.xml"]),
        *tree(HERE / "launch", "share/labyrinth_hw/launch"),
        *tree(HERE / "config", "share/labyrinth_hw/config"),
    ],
    install_requires=[
        "dynamixel-sdk",
        "mcap",
        "numpy",
        "opencv-python-headless",
        "pydantic",
        "pyserial",
        "pyyaml",
        "rosbags",
        "tqdm",
    ],
    # This makes `colcon test` run pytest.
    extras_require={"test": ["pytest"]},
    python_requires=">=3.11",
    zip_safe=False,
    maintainer="The maintainers",
    maintainer_email="maintainers@users.noreply.github.com",
    description="Servo bus, camera and ball tracker of the labyrinth rig, and an emulated testbed.",
    license="Apache-2.0",
    entry_points={} if BY_PIP else PROGRAMS,
)
