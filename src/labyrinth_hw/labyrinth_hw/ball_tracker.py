# SPDX-License-Identifier: Apache-2.0
"""The ball in the picture -> its place on the board.

Steel mirrors the room: it is bright, and as blue as the light is, while wood swallows blue. Brightness in blue beyond
what wood of the same redness shows marks the ball and leaves out shadows (less light, same colour), holes and lines
(dark). A painted marble is marked by the difference of its colour from the wood's. Glare is as bright but larger, so
the mark must be a disc of the ball's size. The disc is measured on the plane
through the ball's centre that faces the camera, where a sphere is a circle: no perspective is left in its middle.
"""

from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from labyrinth_hw.camera import Array, Frame
from labyrinth_hw.landmarks import BoardPose
from labyrinth_hw.marble import Marble, wood_of

Patch = NDArray[np.float32]
Wood = tuple[float, float] | Array
"""Around steel the wood's ratio blue/red and its redness; around a marble its BGR colour (3,)."""


@dataclass(frozen=True)
class BallObservation:
    """One look at the ball.

    Attributes:
        visible: whether it was found; x and y are NaN where not.
        x, y: centre, m, board frame.
        stamp: middle of the exposure, s.
        quality: how much the mark is a disc of the ball's size, 0 to 1; that of the best candidate where not visible.
    """

    visible: bool
    x: float
    y: float
    stamp: float
    quality: float


@dataclass
class BallTracker:
    """Finds one ball, near its last place first, then all over the board.

    Attributes:
        board: (width, depth) m within which a centre can be.
        radius: of the ball, m.
        least_quality: below which nothing counts as visible.
        candidates: places looked at closely when searching the whole board.
        steel: ratio blue/red of steel over that of wood in the same light.
        marble: colour of a painted one; None for steel.
    """

    board: tuple[float, float] = (0.276, 0.231)
    radius: float = 0.00635
    least_quality: float = 0.65
    steel: float = 1.75
    candidates: int = 8
    marble: Marble | None = None
    _last: tuple[float, float] | None = field(default=None, init=False)
    _wood: tuple[float, float] | None = field(default=None, init=False)  # ratio blue/red, and redness

    def __post_init__(self) -> None:
        self._steps = np.linspace(-2, 2, 37)  # of the patch, radii
        across, up = np.meshgrid(self._steps, self._steps)
        self._grid = np.stack([across, up], -1)

    def update(self, frame: Frame, pose: BoardPose | None, stamp: float) -> BallObservation:
        """Where the ball is in this frame; not visible where the board was not found."""
        if pose is None:
            return BallObservation(False, float("nan"), float("nan"), stamp, 0.0)
        region = self._region(frame, pose)
        if region is None:
            return BallObservation(False, float("nan"), float("nan"), stamp, 0.0)
        crop, corner = region
        wood = self._wood_in(crop)
        best: tuple[float, Array] = (0.0, np.full(2, np.nan))
        if self._last is not None:
            best = self._refine(frame, pose, np.array(self._last), wood)
        if best[0] < self.least_quality:
            for place in self._candidates(crop, corner, pose, wood):
                best = max(best, self._refine(frame, pose, place, wood), key=lambda found: found[0])
                if best[0] > 0.8:
                    break
        quality, (x, y) = best
        visible = quality >= self.least_quality
        self._last = (float(x), float(y)) if visible else None
        if not visible:
            x = y = float("nan")
        return BallObservation(bool(visible), float(x), float(y), stamp, float(np.clip(quality, 0, 1)))

    def _region(self, frame: Frame, pose: BoardPose) -> tuple[Frame, NDArray[np.int_]] | None:
        """The part of the frame that holds the board, and its upper left corner, px."""
        width, depth = self.board
        corners = pose.to_image(np.array([(x, y, self.radius) for x in (0, width) for y in (0, depth)]))
        x0, y0 = np.clip(np.floor(corners.min(0)), 0, None).astype(int)
        x1, y1 = np.minimum(np.ceil(corners.max(0)).astype(int), (frame.shape[1], frame.shape[0]))
        return (frame[y0:y1, x0:x1], np.array([x0, y0])) if x1 - x0 > 20 and y1 - y0 > 20 else None

    def _wood_in(self, crop: Frame) -> Wood:
        """The wood, which most of the board is; for steel smoothed over frames."""
        if self.marble is not None:
            return wood_of(crop)
        sample = crop[::6, ::6].reshape(-1, 3).astype(np.float32)
        red = sample[:, 2]
        lit = sample[(red > 0.6 * np.median(red)) & (red < 250)]
        if len(lit) < 50:
            lit = sample
        now = (float(np.median(lit[:, 0] / (lit[:, 2] + 1))), float(np.median(lit[:, 2])))
        if self._wood is not None and abs(now[1] - self._wood[1]) < 30:
            now = (0.9 * self._wood[0] + 0.1 * now[0], 0.9 * self._wood[1] + 0.1 * now[1])
        self._wood = now
        return now

    def _marked(self, crop: Frame, wood: Wood) -> NDArray[np.uint8]:
        """(h, w) how much of the ball each pixel shows, 0 to 255."""
        if self.marble is not None:
            picture = cv2.blur(crop, (3, 3)).astype(np.float32)
            return np.asarray(255 * self.marble.share(picture, np.asarray(wood)), np.uint8)
        ratio, redness = wood
        blue, _, red = cv2.split(cv2.blur(crop, (3, 3)))
        colour = cv2.divide(blue, red, scale=100 / ratio, dtype=cv2.CV_8U)  # 100 for wood
        level = (np.arange(256) / 100 - 1) / (self.steel - 1)
        mark = cv2.LUT(colour, (255 * np.clip(1.5 * level - 0.25, 0, 1)).astype(np.uint8))
        mark[red < 0.25 * redness] = 0
        return np.asarray(mark, np.uint8)

    def _candidates(self, crop: Frame, corner: NDArray[np.int_], pose: BoardPose, wood: Wood) -> list[Array]:
        """Places (m) of the strongest marks of about the ball's size."""
        mark = self._marked(crop, wood)
        depth = float(pose.translation[2]) if pose.translation[2] > 0 else 1.0
        size = pose.intrinsics.fx * self.radius / depth
        inner, outer = (int(2 * round(k * size) + 1) for k in (0.6, 1.7))
        strength = cv2.subtract(cv2.blur(mark, (inner, inner)), cv2.blur(mark, (outer, outer)), dtype=cv2.CV_16S)
        mask = np.zeros(crop.shape[:2], np.uint8)
        outline = [(x, y, self.radius) for x, y in ((0, 0), (1, 0), (1, 1), (0, 1))]
        scaled = np.array(outline) * (*self.board, 1.0)
        cv2.fillConvexPoly(mask, np.round(pose.to_image(scaled) - corner).astype(np.int32), 255)
        places = []
        for _ in range(self.candidates):
            _, peak, _, at = cv2.minMaxLoc(strength, mask)
            if peak < 30:
                break
            places.append(pose.to_board(np.array([at]) + corner, self.radius)[0])
            cv2.circle(mask, at, int(1.5 * size) + 1, 0, -1)
        return places

    def _refine(self, frame: Frame, pose: BoardPose, place: Array, wood: Wood) -> tuple[float, Array]:
        """Quality and centre (m) of the disc near `place` (m)."""
        best = (0.0, place)
        for _ in range(2):
            weight = self._weights(frame, pose, place, wood)
            if weight is None:
                return 0.0, place
            centre = np.array([*place, self.radius])
            across, up = self._facing(centre, pose.eye)
            upright = np.array([across[2], up[2], np.cross(across, up)[2]])  # the board's normal as the patch has it
            at, quality = self._disc(weight, upright)
            if at is None:
                return 0.0, place
            point = centre + self.radius * (at[0] * across + at[1] * up)
            ray = point - pose.eye
            place = (pose.eye + ray * ((self.radius - pose.eye[2]) / ray[2]))[:2]
            best = (quality, place)
        inside = np.all(place > -0.3 * self.radius) and np.all(place < np.array(self.board) + 0.3 * self.radius)
        return best if inside else (0.0, place)

    @staticmethod
    def _facing(centre: Array, eye: Array) -> tuple[Array, Array]:
        """Two unit vectors, near the board's x and y, at right angles to the line of sight."""
        sight = (centre - eye) / np.linalg.norm(centre - eye)
        across = np.array([1.0, 0, 0]) - sight[0] * sight
        across /= np.linalg.norm(across)
        return across, np.cross(across, sight)

    def _weights(self, frame: Frame, pose: BoardPose, place: Array, wood: Wood) -> Patch | None:
        """(37, 37) how much of the ball each point about `place` shows, 0 to 1, on the plane facing the camera."""
        centre = np.array([*place, self.radius])
        across, up = self._facing(centre, pose.eye)
        points = centre + self.radius * (self._grid[..., :1] * across + self._grid[..., 1:] * up)
        pixels = pose.to_image(points.reshape(-1, 3)).astype(np.float32).reshape(37, 37, 2)
        if not (-50 < pixels[18, 18, 0] < frame.shape[1] + 50 and -50 < pixels[18, 18, 1] < frame.shape[0] + 50):
            return None
        patch = cv2.remap(frame, pixels, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        patch = cv2.GaussianBlur(patch.astype(np.float32), (0, 0), 1.2)
        if self.marble is not None:
            return self.marble.share(patch, np.asarray(wood))
        ratio, redness = wood
        blue, red = patch[:, :, 0], patch[:, :, 2]
        colour = (blue / (red + 4) / ratio - 1) / (self.steel - 1)
        bright = red / (0.35 * redness + 1)
        return np.clip(1.5 * colour - 0.25, 0, 1) * np.clip(2 * bright - 1, 0, 1)

    def _disc(self, weight: Patch, upright: Array) -> tuple[Array | None, float]:
        """Centre of the ball (radii from the patch's middle) and the quality of its mark.

        Mean shift, against where the mark of a ball would have its middle: seen aslant, a mirror sphere shows the room
        above the board in a disc that lies towards the board's normal.
        """
        at = np.zeros(2)
        for reach in (1.6, 1.2, 1.2, 1.2, 1.2):
            own = self._grid - at
            window = np.clip((reach - np.hypot(own[..., 0], own[..., 1])) / 0.15, 0, 1)
            near, expected = window * weight, window * self._shape(own, upright)
            total = near.sum()
            if total < 10:
                return None, 0.0
            at = at + np.tensordot(near, own, 2) / total - np.tensordot(expected, own, 2) / expected.sum()
            if np.abs(at).max() > 1.9:
                return None, 0.0
        own = self._grid - at
        room = self._shape(own, upright)
        mark, around = weight[room > 0.9], weight[(room < 0.1) & (np.hypot(own[..., 0], own[..., 1]) < 1.5)]
        if not len(mark) or not len(around):
            return None, 0.0
        return at, float(mark.mean() - around.mean())

    def _shape(self, place: Array, upright: Array) -> Array:
        """Share of the ball's mark, 0 to 1, at `place` (..., 2), radii from its centre."""
        if self.marble is not None:
            return np.asarray(np.clip((1 - np.hypot(place[..., 0], place[..., 1])) / 0.1, 0, 1))
        return _mirrored_room(place, upright)


def _mirrored_room(place: Array, upright: Array) -> Array:
    """Share of the room, 0 to 1, in what a mirror sphere shows at `place` (..., 2), radii, seen along the third axis.

    The mirrored direction is 2 (n . c) n - c for the normal n and the direction c to the camera; what rises above the
    board's plane meets the room, the rest the board.
    """
    square = np.sum(place**2, axis=-1)
    depth = np.sqrt(np.clip(1 - square, 0, None))
    rise = 2 * depth * (place @ upright[:2] + depth * upright[2]) - upright[2]
    return np.clip(rise / 0.2 + 0.5, 0, 1) * (square < 1)
