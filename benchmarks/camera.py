# SPDX-License-Identifier: Apache-2.0
"""Speed and accuracy of the camera line on rendered pictures: `python benchmarks/camera.py [--seed N]`.

Times are processor time of one thread, so other work on the machine hardly changes them.
"""

import argparse
import json
import sys
import time
from pathlib import Path

import cv2
import numpy as np

from labyrinth_hw import config
from labyrinth_hw.ball_tracker import BallTracker
from labyrinth_hw.landmarks import DotPlan, LandmarkTracker
from labyrinth_hw.marble import Marble
from labyrinth_hw.testbed.renderer import Renderer
from labyrinth_hw.testbed.scene import Lighting, Scene

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "src/labyrinth_hw/test"))
from camera_views import CLOSE, CROOKED, FAR, free_place, intrinsics, layout

MARBLE = (190, 70, 30)  # BGR, of config/testbed/cyberrunner.yaml, whose file config/hw/cyberrunner.yaml names


def measure(lens: str, speed: float, rooms: int, frames: int, seed: int, painted: bool = False) -> dict[str, float]:
    """Figures over random rooms; the ball jumps from place to place, so every frame searches the whole board.

    Args:
        painted: a blue marble, by the colour of one click; else steel.
    """
    marble = Marble.load(config.find("marbles", "cyberrunner_blue")) if painted else None
    view, rng = {"close": CLOSE, "far": FAR, "crooked": CROOKED}[lens], np.random.default_rng(seed)
    errors, times, render_times, missed, false, empty = [], [], [], 0, 0, 0
    for room in range(rooms):
        board = layout(("easy", "medium", "hard")[room % 3])
        renderer = Renderer(board, view, Lighting.drawn(rng), seed=room, marble=MARBLE if painted else None)
        marks, tracker = LandmarkTracker(DotPlan.from_sizes(), intrinsics(view)), BallTracker(marble=marble)
        for index in range(frames):
            place, way = free_place(board, rng), rng.uniform(0, 2 * np.pi)
            ball = (float(place[0]), float(place[1])) if index % 5 else None
            velocity = (float(speed * np.cos(way)), float(speed * np.sin(way)))
            tilt = (float(rng.uniform(-0.1, 0.1)), float(rng.uniform(-0.1, 0.1)))
            start = time.process_time()
            frame = renderer.render(Scene(ball=ball, velocity=velocity, tilt=tilt, exposure=0.008))
            rendered = time.process_time()
            pose = marks.update(frame)
            begun = time.process_time()
            seen = tracker.update(frame, pose, 0.0)
            times.append((begun - rendered, time.process_time() - begun))
            render_times.append(rendered - start)
            if ball is None:
                empty, false = empty + 1, false + seen.visible
            elif seen.visible:
                errors.append(float(np.hypot(seen.x - ball[0], seen.y - ball[1])))
            else:
                missed += 1
    off, spent = 1e3 * np.array(errors), 1e3 * np.median(times, axis=0)
    return {
        "rms_mm": float(np.sqrt(np.mean(off**2))), "p95_mm": float(np.quantile(off, 0.95)), "max_mm": float(off.max()),
        "missed": missed / (missed + len(off)), "false": false / empty, "dots_ms": float(spent[0]),
        "ball_ms": float(spent[1]), "fps": 1e3 / float(spent.sum()), "render_ms": 1e3 * float(np.median(render_times)),
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--rooms", type=int, default=12, help="random lights")
    parser.add_argument("--frames", type=int, default=30, help="frames per light")
    parser.add_argument("--json", type=Path, help="also write the figures to this file")
    given = parser.parse_args()
    cv2.setNumThreads(1)
    results: dict[str, dict[str, float]] = {}
    views = [(lens, speed, False) for lens in ("close", "far", "crooked") for speed in (0.0, 0.3)]
    for lens, speed, painted in [*views, ("close", 0.0, True), ("close", 0.3, True)]:
        name = f"{lens} {speed:g} m/s" + (", marble" if painted else "")
        row = results[name] = measure(lens, speed, given.rooms, given.frames, given.seed, painted)
        if len(results) == 1:
            print(f"{'view':<24}" + "".join(f"{word:>11}" for word in row))
        print(name.ljust(24) + "".join(f"{value:11.3f}" for value in row.values()), flush=True)
    if given.json:
        given.json.write_text(json.dumps({"seed": given.seed, "results": results}, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
