# SPDX-License-Identifier: Apache-2.0
"""Blue dots in the picture -> where box and board are.

Four dots sit on the box, which stands still, and four on the board, which turns in it about two axes. Eight numbers
say it all: the camera's pose over the box (6) and the tilt (2). They are fitted to all dots seen at once, so the board
is found with any five dots, and with two of the board's own while the camera is known to stand still.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field
from itertools import combinations, product

import cv2
import numpy as np
from numpy.typing import NDArray

from labyrinth_hw.camera import Array, Frame, Intrinsics, locked
from labyrinth_hw.errors import InputError

SLOTS = ("inner lower left", "inner lower right", "inner upper right", "inner upper left",
         "outer lower left", "outer lower right", "outer upper right", "outer upper left")  # fmt: skip


@dataclass(frozen=True)
class DotPlan:
    """Where the dots are, m, in the board's frame (origin: lower left corner of the inner board) when it is level.

    Attributes:
        board: (2,) size of the inner board; it turns about its centre.
        inner: (4, 3) dots on the board; outer: (4, 3) dots on the box; both from lower left counter-clockwise.
    """

    board: Array
    inner: Array
    outer: Array

    def __post_init__(self) -> None:
        for name, shape in (("board", (2,)), ("inner", (4, 3)), ("outer", (4, 3))):
            value = locked(getattr(self, name))
            if value.shape != shape:
                raise InputError(f"DotPlan.{name} must have shape {shape}, got {value.shape}.")
            object.__setattr__(self, name, value)

    @staticmethod
    def from_sizes(
        board: tuple[float, float] = (0.276, 0.231),
        inner: tuple[float, float] = (0.2835, 0.2385),
        outer: tuple[float, float] = (0.325, 0.280),
        height: float = 0.0065,
    ) -> "DotPlan":
        """Two rectangles of dots about the board's centre, `height` above its floor."""
        corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) / 2
        rows = [np.column_stack([corners * size + np.array(board) / 2, np.full(4, height)]) for size in (inner, outer)]
        return DotPlan(np.array(board), rows[0], rows[1])

    @property
    def pivot(self) -> Array:
        """(3,) the point that both axes run through."""
        return np.array([*self.board / 2, 0.0])


@dataclass(frozen=True)
class DotFinder:
    """Finds blue blobs. Blue means that the blue channel stands out over both others, whatever the light's level.

    Attributes:
        contrast: share of the bluest dots' excess of blue at which a blob's rim is drawn.
        least: excess of blue over red and green, grey levels, below which nothing is a dot.
        area: smallest and largest blob, px.
    """

    contrast: float = 0.4
    least: int = 18
    area: tuple[int, int] = (8, 900)

    def find(self, frame: Frame) -> tuple[Array, Array]:
        """Centres of blue blobs in a BGR picture, by blueness: (n, 2) px of whole dots, (k, 2) px of doubtful ones.

        Doubtful are blobs cut by the picture's edge and those much larger or smaller than most: two dots in one, or
        a slice of one. At most 12 of either kind, largest first.
        """
        blue, green, red = cv2.split(frame)
        excess = cv2.subtract(blue, cv2.max(green, red))
        excess = cv2.blur(excess, (3, 3))
        threshold = max(self.least, self.contrast * float(cv2.minMaxLoc(excess)[1]))
        mask = cv2.threshold(excess, threshold, 255, cv2.THRESH_BINARY)[1]
        _, labels, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=8)
        x, y, width, height, areas = stats[1:].T
        inside = (x > 0) & (y > 0) & (x + width < frame.shape[1]) & (y + height < frame.shape[0])
        blobs = (areas >= self.area[0]) & (areas <= self.area[1])
        whole = blobs & inside
        if whole.any():
            typical = np.median(areas[whole])
            whole &= (areas > 0.5 * typical) & (areas < 1.6 * typical)
        kinds = []
        for kind in (whole, blobs & ~whole):
            chosen = sorted((int(i) for i in np.flatnonzero(kind)), key=lambda i: -int(areas[i]))[:12]
            kinds.append(np.array([self._centre(excess, labels, stats[i + 1], i + 1) for i in chosen]).reshape(-1, 2))
        return kinds[0], kinds[1]

    @staticmethod
    def _centre(excess: Frame, labels: NDArray[np.int32], box: NDArray[np.int32], label: int) -> tuple[float, float]:
        x, y, width, height = (int(n) for n in box[:4])
        x0, y0 = max(x - 2, 0), max(y - 2, 0)  # the soft rim belongs to the dot
        part = (slice(y0, y + height + 2), slice(x0, x + width + 2))
        own = (labels[part] == 0) | (labels[part] == label)
        moments = cv2.moments(np.where(own, excess[part], 0).astype(np.float32))
        return x0 + moments["m10"] / moments["m00"], y0 + moments["m01"] / moments["m00"]


def counter_clockwise(points: Array) -> Array | None:
    """(4, 2) in the order lower left, lower right, upper right, upper left of the picture; None if not convex."""
    centre = points.mean(0)
    angle = np.arctan2(-(points[:, 1] - centre[1]), points[:, 0] - centre[0])  # picture y runs down
    ordered = points[np.argsort(angle)]  # from -pi: lower left first
    edges = np.roll(ordered, -1, 0) - ordered
    turn = edges[:, 0] * np.roll(edges[:, 1], -1) - edges[:, 1] * np.roll(edges[:, 0], -1)
    return ordered if (turn < 0).all() else None


@dataclass(frozen=True)
class BoardPose:
    """Where the camera saw the board.

    Attributes:
        camera: (6,) rotation vector and translation (m) that take box points into the camera frame.
        tilt: (2,) rad, board = Rx(tilt[0]) Ry(tilt[1]) about the pivot, right-handed in the box frame.
        rotation, translation: (3, 3) and (3,) m, board points into the camera frame.
        homography: (3, 3) board floor (x, y, 1) m -> undistorted picture px.
        dots: (8, 2) px where each of `SLOTS` was seen, NaN where not.
        residual: root mean square distance of seen dots from where the pose puts them, px.
        intrinsics: the lens it holds for.
    """

    camera: Array
    tilt: Array
    rotation: Array
    translation: Array
    homography: Array
    dots: Array
    residual: float
    intrinsics: Intrinsics

    def __post_init__(self) -> None:
        for name in ("camera", "tilt", "rotation", "translation", "homography", "dots"):
            object.__setattr__(self, name, locked(getattr(self, name)))

    @property
    def seen(self) -> tuple[str, ...]:
        """Names of the dots that were seen."""
        return tuple(name for name, dot in zip(SLOTS, self.dots, strict=True) if np.isfinite(dot[0]))

    @property
    def eye(self) -> Array:
        """(3,) m: the camera in the board frame."""
        return -self.rotation.T @ self.translation

    def to_image(self, points: Array) -> Array:
        """(n, 3) m, board frame -> (n, 2) px, lens distortion included."""
        turn = cv2.Rodrigues(np.array(self.rotation))[0]
        image, _ = cv2.projectPoints(
            np.asarray(points, float).reshape(-1, 3), turn, np.array(self.translation), *self.intrinsics.arrays()
        )
        return image.reshape(-1, 2)

    def to_board(self, pixels: Array, height: float = 0.0) -> Array:
        """(n, 2) px -> (n, 2) m on the plane `height` above the board's floor."""
        rays = self.intrinsics.rays(pixels) @ self.rotation  # (n, 3), board frame
        eye = self.eye
        return eye[:2] + rays[:, :2] * ((height - eye[2]) / rays[:, 2:])


@dataclass
class LandmarkTracker:
    """Follows the dots from frame to frame; finds them again when lost.

    Attributes:
        plan, intrinsics: what is known of rig and lens.
        quarter_turns: how often the camera is turned by 90 degrees (counter-clockwise in the picture); the rest may
            be up to about 40 degrees.
        gate: px that a dot may jump between frames.
        suspect: px of residual above which each dot is tested for being wrong.
        tolerance: px of residual above which a fit to all dots is not believed; less with fewer dots to check it.
        vague: rad of tilt per px of error in the dots above which a fit is not believed: two dots of the board on one
            diagonal do not determine the turn about it.
        lost: frames so far in which no pose was believed.
    """

    plan: DotPlan
    intrinsics: Intrinsics
    finder: DotFinder = field(default_factory=DotFinder)
    quarter_turns: int = 0
    gate: float = 9.0
    suspect: float = 0.35
    tolerance: float = 1.0
    vague: float = 0.04
    last: BoardPose | None = None
    lost: int = 0

    def update(self, frame: Frame) -> BoardPose | None:
        """The pose in this frame; None if the dots do not determine it. Raises InputError for a frame of another
        size."""
        if frame.ndim != 3 or frame.shape[:2] != (self.intrinsics.height, self.intrinsics.width):
            wanted = f"({self.intrinsics.height}, {self.intrinsics.width}, 3)"
            raise InputError(f"Expected a frame of shape {wanted} as the intrinsics say, got {frame.shape}.")
        found, doubtful = self.finder.find(frame)
        pose = self._follow(found, self.last) if self.last is not None else None
        if pose is None:
            pose = self._acquire(found, doubtful)
        if pose is None:
            self.lost += 1
        else:
            self.last = pose
        return pose

    def _follow(self, found: Array, last: BoardPose) -> BoardPose | None:
        """From the last tilt; from tilts all over the range where that leaves whole dots unexplained."""
        pose = self._settle(found, np.concatenate([last.camera, last.tilt]))
        if pose is not None and len(pose.seen) >= min(len(found), 8) and pose.residual <= self.suspect:
            return pose if self._sure(pose) else None
        angles = np.linspace(-0.12, 0.12, 5)
        starts = [np.concatenate([last.camera, tilt]) for tilt in product(angles, angles)]
        poses = [pose, *(self._settle(found, start) for start in starts)]
        sure = [p for p in (self._refit(p) for p in poses if p is not None) if p is not None]
        return min(sure, key=lambda p: (-len(p.seen), p.residual), default=None)

    def _settle(self, found: Array, start: Array) -> BoardPose | None:
        """Match and fit in turn: a fit to some of the dots brings the others within reach."""
        pose = None
        for gate in (self.gate, self.gate, self.gate / 2):
            pose = self._fit(start, self._match(found, self._predict(start), gate))
            if pose is None:
                return None
            start = np.concatenate([pose.camera, pose.tilt])
        return pose

    def _sure(self, pose: BoardPose) -> bool:
        """Whether the dots determine the tilt, and enough of them are left over to check it."""
        seen = np.isfinite(pose.dots[:, 0])
        free = self._free(seen)
        slope = self._project(np.concatenate([pose.camera, pose.tilt]))[1][seen][:, :, free]
        numbers = slope.shape[2]
        _, strength, ways = np.linalg.svd(slope.reshape(-1, numbers), full_matrices=False)
        if 2 * seen.sum() <= numbers or strength[-1] < 1e-9:
            return False
        spread = np.linalg.norm(ways[:, -2:] / strength[:, None])  # of the tilt, rad per px
        spare = 2 * int(seen.sum()) - 8 if numbers == 8 else 2 * int(seen[:4].sum()) - 2
        return bool(spread <= self.vague and pose.residual <= self.tolerance * min(1.0, spare / 8))

    @staticmethod
    def _free(seen: NDArray[np.bool_]) -> slice:
        """All eight numbers; the tilt alone where the box's dots are too few."""
        box, every = seen[4:].sum(), seen.sum()
        return slice(0, 8) if box >= 3 or (every >= 6 and box >= 2) else slice(6, 8)

    def _refit(self, pose: BoardPose) -> BoardPose | None:
        """Without the worst dot, at most two of them: one half covered or fused with another pulls the fit."""
        for _ in range(2):
            if pose.residual <= self.suspect:
                break
            values = np.concatenate([pose.camera, pose.tilt])
            dots = np.array(pose.dots)
            if np.isfinite(dots[:, 0]).sum() < 6:
                break
            dots[int(np.nanargmax(np.linalg.norm(dots - self._predict(values), axis=1)))] = np.nan
            better = self._fit(values, dots)
            if better is None or better.residual > pose.residual / 2:
                break
            pose = better
        return pose if self._sure(pose) else None

    def _acquire(self, found: Array, doubtful: Array) -> BoardPose | None:
        """Tries every four blobs as every choice of one dot per corner; the pose that explains most whole dots wins."""
        blobs = np.vstack([found, doubtful])[:10]
        best: tuple[int, float] = (4, np.inf)
        winner: BoardPose | None = None
        for quad in combinations(range(len(blobs)), 4):
            ordered = counter_clockwise(blobs[list(quad)])
            if ordered is None:
                continue
            ordered = np.roll(ordered, -self.quarter_turns, axis=0)
            for outer in product((0, 1), repeat=4):
                points = np.where(np.array(outer)[:, None] == 1, self.plan.outer, self.plan.inner)
                start = self._start(points, ordered)
                if start is None:
                    continue
                pose = None
                for gate in (22.0, 9.0, 4.0):  # px; the first guess knows nothing of the tilt
                    dots = self._match(found, self._predict(start), gate)
                    count = int(np.isfinite(dots[:, 0]).sum())
                    pose = self._fit(start, dots, known_camera=False) if count >= max(5, best[0]) else None
                    if pose is None:
                        break
                    start = np.concatenate([pose.camera, pose.tilt])
                if pose is None or pose.residual > self.tolerance:
                    continue
                if (-count, pose.residual) < (-best[0], best[1]):
                    best, winner = (count, pose.residual), pose
        return self._refit(winner) if winner is not None else None

    def _start(self, points: Array, pixels: Array) -> Array | None:
        """(8,) first guess: the box's pose if the board were level; None if the camera looks from the side or from
        below."""
        ok, turn, shift = cv2.solvePnP(points, pixels, *self.intrinsics.arrays(), flags=cv2.SOLVEPNP_IPPE)
        if not ok or shift[2] <= 0 or cv2.Rodrigues(turn)[0][2, 2] > -0.7:
            return None
        return np.concatenate([turn.ravel(), shift.ravel(), (0.0, 0.0)])

    def _match(self, found: Array, expected: Array, gate: float) -> Array:
        """(8, 2) the blob nearest to each expected dot where each is the other's nearest; NaN elsewhere."""
        dots = np.full((8, 2), np.nan)
        if not len(found):
            return dots
        apart = np.linalg.norm(found[:, None] - expected, axis=2)  # (n, 8)
        for slot in range(8):
            blob = int(np.argmin(apart[:, slot]))
            if apart[blob, slot] < gate and int(np.argmin(apart[blob])) == slot:
                dots[slot] = found[blob]
        return dots

    def _predict(self, values: Array) -> Array:
        """(8, 2) px where the dots are for camera (6) and tilt (2)."""
        return self._project(values)[0]

    def _project(self, values: Array) -> tuple[Array, Array]:
        """Where the dots are (8, 2) px, and how that changes with each of the eight numbers (8, 2, 8)."""
        a, b = values[6:]
        arm = self.plan.inner - self.plan.pivot
        inner = arm @ board_turn((a, b)).T + self.plan.pivot
        image, jacobian = cv2.projectPoints(
            np.vstack([inner, self.plan.outer]), values[:3], values[3:6], *self.intrinsics.arrays()
        )
        slope = np.zeros((8, 2, 8))
        slope[:, :, :6] = jacobian[:, :6].reshape(8, 2, 6)
        about_x, about_y = np.array([1.0, 0.0, 0.0]), np.array([0.0, np.cos(a), np.sin(a)])  # the axes of both joints
        camera = cv2.Rodrigues(values[:3])[0]
        for column, axis in ((6, about_x), (7, about_y)):
            moved = _cross(axis, inner - self.plan.pivot) @ camera.T  # (4, 3), camera frame
            slope[:4, :, column] = np.einsum("nij,nj->ni", slope[:4, :, 3:6], moved)
        return image.reshape(-1, 2), slope

    def _fit(self, start: Array, dots: Array, known_camera: bool = True) -> BoardPose | None:
        """Gauss-Newton on the seen dots, all eight numbers; the tilt alone where the box's dots are too few."""
        seen = np.isfinite(dots[:, 0])
        if seen[:4].sum() < 2:
            return None
        free = self._free(seen) if known_camera else slice(0, 8)
        if not known_camera and seen.sum() < 5:
            return None
        values = np.array(start, float)
        for _ in range(8):
            expected, slope = self._project(values)
            error = (dots - expected)[seen].ravel()
            change = np.linalg.lstsq(slope[seen][:, :, free].reshape(len(error), -1), error, rcond=None)[0]
            values[free] += change
            if np.abs(change).max() < 1e-5:
                break
        if not np.isfinite(values).all() or np.abs(values[6:]).max() > 0.5:
            return None
        error = np.linalg.norm((dots - self._predict(values))[seen], axis=1)
        return self._pose(values, dots, float(np.sqrt(np.mean(error**2))))

    def _pose(self, values: Array, dots: Array, residual: float) -> BoardPose:
        camera, board = cv2.Rodrigues(values[:3])[0], board_turn(values[6:])
        rotation = camera @ board
        translation = camera @ (self.plan.pivot - board @ self.plan.pivot) + values[3:6]
        homography = self.intrinsics.arrays()[0] @ np.column_stack([rotation[:, :2], translation])
        homography /= homography[2, 2]
        return BoardPose(values[:6], values[6:], rotation, translation, homography, dots, residual, self.intrinsics)


def _cross(axis: Array, arms: Array) -> Array:
    """(n, 3) of one axis (3,) and arms (n, 3); numpy's own takes twice as long for so few."""
    (x, y, z), (u, v, w) = axis, arms.T
    return np.column_stack([y * w - z * v, z * u - x * w, x * v - y * u])


def board_turn(tilt: Iterable[float]) -> Array:
    """(3, 3) rotation of the board in the box: Rx(tilt_x) Ry(tilt_y)."""
    a, b = tilt
    ca, sa, cb, sb = np.cos(a), np.sin(a), np.cos(b), np.sin(b)
    return np.array([[cb, 0, sb], [sa * sb, ca, -sa * cb], [-ca * sb, sa, ca * cb]])
