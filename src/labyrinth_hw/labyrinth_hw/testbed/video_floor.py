# SPDX-License-Identifier: Apache-2.0
"""The board's floor as a texture seen from straight above: wood, path, holes, shadows, the ball's shade, glare."""

import cv2
import numpy as np
from numpy.typing import NDArray

from labyrinth_hw.testbed.video_scene import Array, Layout, Lighting, Scene

Frame = NDArray[np.uint8]
Slices = tuple[slice, slice]
TEXELS = 2500.0  # px per m
FLOOR, LINE, HOLE = (112, 160, 198), (30, 30, 34), (16, 18, 22)  # BGR


class Floor:
    """Drawn once for a layout and a light; each scene adds the ball's shade and moves the glare.

    Args:
        height: of the camera above the board, m.
        rng: draws the wood's grain.
    """

    def __init__(self, layout: Layout, lighting: Lighting, height: float, rng: np.random.Generator) -> None:
        self.layout, self.lighting, self._height = layout, lighting, height
        self._lamp = np.array(lighting.lamp) / np.linalg.norm(lighting.lamp)
        self._texture, self._varnish = self._draw(rng)
        self._shade, self._glare = self._draw_shade(), self._draw_glare()

    @property
    def metres(self) -> Array:
        """(3, 3) texture px -> m on the floor."""
        size, half = 1 / TEXELS, 0.5 / TEXELS
        return np.array([[size, 0, half], [0, -size, self.layout.board[1] - half], [0, 0, 1]])

    def lit(self, scene: Scene) -> Frame:
        """The texture with the ball's shade and the glare where the tilt puts it."""
        light = self.lighting
        if scene.ball is None and light.glare == 0:
            return self._texture
        floor = self._texture.copy()
        if scene.ball is not None:
            at = self._texel(np.array([scene.ball]))[0]
            corner = np.floor(at).astype(int) - 80
            shift = np.array([[1, 0, at[0] - 80 - corner[0]], [0, 1, at[1] - 80 - corner[1]]], np.float32)
            shade = cv2.warpAffine(self._shade, shift, (162, 162), borderValue=1.0)
            here, there = _overlap(floor, shade, corner)
            floor[here] = floor[here] * shade[there][..., None]
        if light.glare > 0:
            # A mirror turned by a turns its image by 2 a: from a height h it wanders over the floor by h a.
            wander = self._height * np.array([scene.tilt[1], -scene.tilt[0]])
            centre = np.array(light.glare_at) * self.layout.board + wander
            corner = np.round(self._texel(centre[None])[0]).astype(int) - self._glare.shape[0] // 2
            here, there = _overlap(floor, self._glare, corner)
            floor[here] = np.minimum(floor[here] + self._glare[there] * self._varnish[here], 255)
        return floor

    def _texel(self, points: Array) -> Array:
        """(n, 2) m on the floor -> (n, 2) texture px; y runs down in the texture."""
        return np.column_stack([points[:, 0], self.layout.board[1] - points[:, 1]]) * TEXELS - 0.5

    def _draw(self, rng: np.random.Generator) -> tuple[Frame, NDArray[np.float32]]:
        """The level floor's texture, and the share of the varnish that mirrors."""
        board = self.layout.board
        size = (round(board[0] * TEXELS), round(board[1] * TEXELS))
        grain = rng.standard_normal((size[1], size[0])).astype(np.float32)
        grain = cv2.GaussianBlur(grain, (0, 0), 25, sigmaY=1.2)
        floor = np.array(FLOOR, np.float32) * (1 + 0.04 * grain[..., None] / grain.std())
        floor = np.ascontiguousarray(np.clip(floor, 0, 255).astype(np.uint8))
        varnish = np.ones((size[1], size[0], 3), np.float32)  # holes mirror nothing
        path = np.round(self._texel(np.array(self.layout.path).reshape(-1, 2)) * 16).astype(np.int32)
        if len(path):
            cv2.polylines(floor, [path], False, LINE, round(0.0016 * TEXELS), cv2.LINE_AA, 4)
        reach = -self._lamp[:2] / self._lamp[2] * self.layout.wall_height
        shadow = np.zeros(floor.shape[:2], np.uint8)
        for x0, y0, x1, y1 in [*self.layout.walls, *self.layout.rim()]:
            foot = np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)])
            outline = cv2.convexHull(self._texel(np.vstack([foot, foot + reach])).astype(np.float32))
            cv2.fillConvexPoly(shadow, np.round(outline).astype(np.int32), 255)
        soft = cv2.GaussianBlur(shadow, (0, 0), 3).astype(np.float32) / 255
        floor = (floor * (1 - self.lighting.shadow * soft[..., None])).astype(np.uint8)
        for hole in self._texel(np.array(self.layout.holes).reshape(-1, 2)):
            at = tuple(int(v) for v in np.round(hole * 16))
            radius = self.layout.hole_radius * TEXELS
            cv2.circle(floor, at, round(radius * 16), (70, 104, 132), -1, cv2.LINE_AA, 4)
            cv2.circle(floor, at, round((radius - 1.5) * 16), HOLE, -1, cv2.LINE_AA, 4)
            cv2.circle(varnish, at, round(radius * 16), (0.0, 0.0, 0.0), -1, cv2.LINE_8, 4)
        return np.ascontiguousarray(floor), varnish

    def _draw_shade(self) -> NDArray[np.float32]:
        """Share of the light that the ball leaves on the floor around its contact point, 161 x 161 texels."""
        half, radius = 80, self.layout.ball_radius * TEXELS
        shade = np.zeros((2 * half + 1, 2 * half + 1), np.float32)
        reach = np.array([-self._lamp[0], self._lamp[1]]) / self._lamp[2] * radius
        length = radius / self._lamp[2]
        angle = float(np.degrees(np.arctan2(reach[1], reach[0])))
        cv2.ellipse(shade, ((half + reach[0], half + reach[1]), (2 * length, 2 * radius), angle), 1.0, -1)
        soft = self.lighting.shadow * cv2.GaussianBlur(shade, (0, 0), 3.0)
        y, x = np.mgrid[-half : half + 1, -half : half + 1]
        contact = 0.5 * np.exp(-(x**2 + y**2) / (2 * (0.55 * radius) ** 2))
        return ((1 - soft) * (1 - contact)).astype(np.float32)

    def _draw_glare(self) -> NDArray[np.float32]:
        """The varnish's mirror image of a window, grey levels, to be added."""
        size = self.lighting.glare_size * TEXELS
        half = int(2.5 * size)
        v, u = np.mgrid[-half : half + 1, -half : half + 1] / size
        glare = 255 * self.lighting.glare * np.exp(-((u**2 + v**2) ** 1.5) / 2)
        return np.repeat(glare[..., None], 3, 2).astype(np.float32)


def _overlap(picture: Frame, patch: NDArray[np.float32], corner: NDArray[np.int_]) -> tuple[Slices, Slices]:
    """Where a patch whose upper left corner is at `corner` lies in the picture, and which part of it that is."""
    x, y = int(corner[0]), int(corner[1])
    x0, y0 = max(x, 0), max(y, 0)
    x1, y1 = max(min(x + patch.shape[1], picture.shape[1]), x0), max(min(y + patch.shape[0], picture.shape[0]), y0)
    return (slice(y0, y1), slice(x0, x1)), (slice(y0 - y, y1 - y), slice(x0 - x, x1 - x))
