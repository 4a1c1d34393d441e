# SPDX-License-Identifier: Apache-2.0
"""Pictures of the emulated rig with known truth, as its camera would take them.

Drawn at twice the resolution through a pinhole, averaged down, then bent by the lens. The ball is ray-cast: a mirror of
the room above it and the board around it. Nothing here is shared with the tracker that has to find the ball again.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from labyrinth_hw.testbed.scene import Array, Layout, Lens, Lighting, Scene, turn_x, turn_y

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


FINE = 2  # drawn pixels per picture pixel
SHIFT = 6  # fractional bits of polygon corners
WALL, RIM, BOX = (138, 182, 214), (78, 122, 164), (62, 100, 142)
INSIDE, TABLE, DOT = (34, 40, 46), (92, 92, 90), (168, 78, 22)  # BGR


class Renderer:
    """Renders scenes of one layout through one lens in one light. Noise follows `seed`.

    `marble` is the BGR colour of a painted marble; without one the ball is of steel.
    """

    def __init__(
        self, layout: Layout, lens: Lens | None = None, lighting: Lighting | None = None, seed: int = 0,
        marble: tuple[int, int, int] | None = None,
    ) -> None:  # fmt: skip
        self.marble = marble
        self.layout, self.lens, self.lighting = layout, lens or Lens.at_height(0.25), lighting or Lighting()
        self._rng = np.random.default_rng(seed)
        self._noise = self._rng.standard_normal((720, 1280, 3)).astype(np.float32)
        bent = any(self.lens.distortion)
        self._margin = 60 if bent else 0  # what a barrel lens sees beyond the pinhole's picture
        width, height = (n + 2 * self._margin for n in self.lens.size)
        self._canvas = (width * FINE, height * FINE)
        focal = self.lens.focal * FINE
        centre = (np.array(self._canvas) - 1) / 2
        self._pinhole = np.array([[focal, 0, centre[0]], [0, focal, centre[1]], [0, 0, 1]])
        self._bend = self._bend_map() if bent else None
        level_view = np.diag([1.0, -1.0, -1.0])  # x right, y down, z away from the camera
        self._turn = cv2.Rodrigues(np.array(self.lens.turn))[0] @ level_view
        self._centre = np.array([*layout.board, 0.0]) / 2
        self._eye = self._centre + np.array(self.lens.position)
        lamp = np.array(self.lighting.lamp)
        self._lamp = lamp / np.linalg.norm(lamp)
        self._floor = Floor(layout, self.lighting, self.lens.position[2], self._rng)
        self._field = self._draw_field()
        self._solids = np.array([*layout.walls, *layout.rim()])

    # -- the fixed parts, drawn once ----------------------------------------------------------------------------------

    def _draw_field(self) -> NDArray[np.float32]:
        """Light that multiplies the picture."""
        width, height = self.lens.size
        x, y = np.meshgrid(np.linspace(-0.5, 0.5, width), np.linspace(0.5, -0.5, height))
        light = self.lighting
        vignette = 1 - 0.25 * (x**2 + y**2)
        field = light.level * (1 + light.gradient[0] * x + light.gradient[1] * y) * vignette
        tint = np.array([1 - light.warmth, 1 - light.warmth / 3, 1 + light.warmth / 4])
        return (field[..., None] * tint).astype(np.float32)

    def _bend_map(self) -> NDArray[np.float32]:
        width, height = self.lens.size
        focal, centre = self.lens.focal, ((width - 1) / 2, (height - 1) / 2)
        matrix = np.array([[focal, 0, centre[0]], [0, focal, centre[1]], [0, 0, 1]])
        grid = np.stack(np.meshgrid(np.arange(width), np.arange(height)), -1).reshape(-1, 1, 2).astype(np.float64)
        straight = cv2.undistortPoints(grid, matrix, np.array(self.lens.distortion), P=matrix)
        return (straight.reshape(height, width, 2) + self._margin).astype(np.float32)

    # -- one frame ----------------------------------------------------------------------------------------------------

    def board_pose(self, tilt: tuple[float, float]) -> tuple[Array, Array]:
        """Rotation (3, 3) and translation (3,) m that take board points into the camera frame."""
        board = turn_x(tilt[0]) @ turn_y(tilt[1])
        return self._turn @ board, self._turn @ (self._centre - board @ self._centre - self._eye)

    def render(self, scene: Scene) -> Frame:
        """The picture (height, width, 3), BGR."""
        if scene.lens_covered:
            return self._expose(np.full((self.lens.size[1], self.lens.size[0], 3), 3, np.uint8), scene, lit=False)
        rotation, translation = self.board_pose(scene.tilt)
        canvas = np.empty((self._canvas[1], self._canvas[0], 3), np.uint8)
        canvas[:] = TABLE
        self._draw_box(canvas, scene.tilt)
        self._draw_board(canvas, rotation, translation, scene)
        picture = cv2.resize(canvas, None, fx=1 / FINE, fy=1 / FINE, interpolation=cv2.INTER_AREA)
        if self._bend is not None:
            picture = cv2.remap(picture, self._bend, None, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
        return self._expose(picture, scene)

    def _project(self, points: Array) -> Array:
        """(n, 3) m in the camera frame -> (n, 2) canvas px."""
        image = points @ self._pinhole.T
        return image[:, :2] / image[:, 2:]

    def _fill(self, canvas: Frame, corners: Array, colour: tuple[float, ...]) -> None:
        cv2.fillConvexPoly(canvas, np.round(corners * 2**SHIFT).astype(np.int32), colour, cv2.LINE_8, SHIFT)

    def _draw_box(self, canvas: Frame, tilt: tuple[float, float]) -> None:
        frame = turn_x(tilt[0])
        rings: list[tuple[float, tuple[int, int, int], Array]] = [
            (0.0305, BOX, np.eye(3)), (0.0185, INSIDE, np.eye(3)), (0.017, RIM, frame), (0.010, INSIDE, frame)
        ]  # fmt: skip
        for beyond, colour, turn in rings:
            size = (self.layout.board[0] + 2 * beyond, self.layout.board[1] + 2 * beyond)
            corners = (self.layout.dots(size) - self._centre) @ turn.T + self._centre - self._eye
            self._fill(canvas, self._project(corners @ self._turn.T), colour)
        self._draw_dots(canvas, self.layout.outer_dots, self._turn, -self._turn @ self._eye)

    def _draw_dots(self, canvas: Frame, size: tuple[float, float], rotation: Array, translation: Array) -> None:
        angle = np.linspace(0, 2 * np.pi, 36, endpoint=False)
        circle = np.column_stack([np.cos(angle), np.sin(angle), 0 * angle]) * self.layout.dot_diameter / 2
        for dot in self.layout.dots(size):
            self._fill(canvas, self._project((circle + dot) @ rotation.T + translation), DOT)

    def _draw_board(self, canvas: Frame, rotation: Array, translation: Array, scene: Scene) -> None:
        floor = self._floor.lit(scene)
        columns = np.column_stack([rotation[:, 0], rotation[:, 1], translation])
        warp = self._pinhole @ columns @ self._floor.metres
        cv2.warpPerspective(floor, warp, self._canvas, canvas, cv2.INTER_LINEAR, cv2.BORDER_TRANSPARENT)
        eye = rotation.T @ -translation  # camera in the board frame
        boxes = self._solids
        nearest = np.clip(eye[:2], boxes[:, :2], boxes[:, 2:])
        order = np.argsort(-np.linalg.norm(nearest - eye[:2], axis=1))
        corners = _corners(boxes, self.layout.wall_height)  # (n, 8, 3)
        flat = self._project(corners.reshape(-1, 3) @ rotation.T + translation).reshape(-1, 8, 2)
        behind = np.ones(len(boxes), bool) if scene.ball is None else _behind(boxes, np.array(scene.ball), eye)
        for index in order[behind[order]]:
            self._draw_solid(canvas, boxes[index], flat[index], eye, index >= len(self.layout.walls))
        self._draw_dots(canvas, self.layout.inner_dots, rotation, translation)
        if scene.ball is not None:
            self._draw_ball(canvas, rotation, translation, scene)
            for index in order[~behind[order]]:
                self._draw_solid(canvas, boxes[index], flat[index], eye, index >= len(self.layout.walls))
            if not behind.all():
                self._draw_dots(canvas, self.layout.inner_dots, rotation, translation)

    def _draw_solid(self, canvas: Frame, box: Array, flat: Array, eye: Array, rim: bool) -> None:
        colour = np.array(RIM if rim else WALL, np.float64)
        x0, y0, x1, y1 = box
        sides = (
            ((0, 1, 5, 4), eye[1] < y0, -self._lamp[1]), ((2, 3, 7, 6), eye[1] > y1, self._lamp[1]),
            ((3, 0, 4, 7), eye[0] < x0, -self._lamp[0]), ((1, 2, 6, 5), eye[0] > x1, self._lamp[0]),
        )  # fmt: skip
        for corners, seen, towards in sides:
            if seen:
                self._fill(canvas, flat[list(corners)], tuple(colour * (0.68 + 0.3 * towards)))
        self._fill(canvas, flat[4:], tuple(colour))

    def _draw_ball(self, canvas: Frame, rotation: Array, translation: Array, scene: Scene) -> None:
        assert scene.ball is not None
        radius = self.layout.ball_radius
        smear = np.hypot(*scene.velocity) * scene.exposure * self._pinhole[0, 0] / max(self.lens.position[2], 0.05)
        steps = int(np.clip(np.ceil(smear), 1, 8))
        times = (np.arange(steps) + 0.5) / steps - 0.5
        moved = np.array(scene.ball) + times[:, None] * np.array(scene.velocity) * scene.exposure
        centres = np.column_stack([moved, np.full(steps, radius)]) @ rotation.T + translation
        at = self._project(centres)
        reach = 1.6 * self._pinhole[0, 0] * radius / centres[:, 2].min() + 3
        x0, y0 = np.maximum(np.floor(at.min(0) - reach), 0).astype(int)
        x1, y1 = np.minimum(np.ceil(at.max(0) + reach), self._canvas).astype(int)
        if x1 <= x0 or y1 <= y0:
            return
        u, v = np.meshgrid(np.arange(x0, x1), np.arange(y0, y1))
        rays = np.stack([u - self._pinhole[0, 2], v - self._pinhole[1, 2], np.full(u.shape, self._pinhole[0, 0])], -1)
        rays = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
        paint, cover = np.zeros((*u.shape, 3)), np.zeros((*u.shape, 1))
        for centre in centres:
            colour, alpha = self._ball_colour(rays, centre, rotation)
            paint += colour * alpha / steps
            cover += alpha / steps
        patch = canvas[y0:y1, x0:x1]
        patch[:] = np.clip(patch * (1 - cover) + paint, 0, 255).astype(np.uint8)

    def _ball_colour(self, rays: Array, centre: Array, rotation: Array) -> tuple[Array, Array]:
        """What the ball shows along each ray (h, w, 3), and how much of the pixel it covers (h, w, 1).

        Steel mirrors; a painted marble is matt (Lambert), under lamp and sky, with a glossy coat that mirrors a little.
        """
        radius = self.layout.ball_radius
        along = rays @ centre
        miss = np.sqrt(np.maximum(centre @ centre - along**2, 0))  # distance of the ray from the centre
        per_pixel = centre[2] / self._pinhole[0, 0]
        alpha = np.clip(0.5 + (radius - miss) / per_pixel, 0, 1)[..., None]
        depth = along - np.sqrt(np.maximum(radius**2 - miss**2, 0))
        normal = (rays * depth[..., None] - centre) / radius
        mirrored = (rays - 2 * np.sum(rays * normal, -1, keepdims=True) * normal) @ self._turn  # box frame
        to_eye = -(centre @ self._turn) / np.linalg.norm(centre)
        light = self.lighting
        up = mirrored @ (self._turn.T @ rotation[:, 2])  # above the board's own plane or below
        room = 150 + 75 * np.clip(up, 0, 1)
        room *= 1 + light.room_gradient[0] * mirrored[..., 0] + light.room_gradient[1] * mirrored[..., 1]
        room *= 1 - 0.35 / (1 + np.exp(-(mirrored @ to_eye - 0.97) / 0.006))  # the camera's own mirror image
        lamp = 500 * light.lamp_strength * np.exp((mirrored @ self._lamp - 1) * 60)
        board = np.array(FLOOR) * np.clip(0.75 + 0.9 * up, 0.15, 0.75)[..., None]
        sky = np.clip((up + 0.05) / 0.15, 0, 1)[..., None]
        mirror = 0.85 * (sky * (room + lamp)[..., None] + (1 - sky) * board)
        if self.marble is None:
            return mirror, alpha
        facing = normal @ self._turn
        lit = 0.55 + 0.25 * (facing @ self._turn.T @ rotation[:, 2]) + 0.4 * np.clip(facing @ self._lamp, 0, 1)
        return np.clip(0.93 * lit[..., None] * np.array(self.marble, float) + 0.07 * mirror, 0, 255), alpha

    def _expose(self, picture: Frame, scene: Scene, lit: bool = True) -> Frame:
        light, lens = self.lighting, self.lens
        values = picture.astype(np.float32)
        if lit:
            values *= self._field
        for x, y, width, height in scene.covers:
            values[max(y, 0) : max(y + height, 0), max(x, 0) : max(x + width, 0)] = (60, 75, 110)
        if light.blur > 0:
            values = cv2.GaussianBlur(values, (0, 0), light.blur)
        if light.noise > 0:
            width, height = lens.size
            x, y = (int(self._rng.integers(0, limit + 1)) for limit in (1280 - width, 720 - height))
            spread = cv2.sqrt(np.maximum(values, 0) / 128 + 1) * light.noise
            values += spread * self._noise[y : y + height, x : x + width]
        return np.clip(values + 0.5, 0, 255).astype(np.uint8)


def _corners(boxes: Array, height: float) -> Array:
    """(n, 8, 3): the four corners at the foot, counter-clockwise, then the four on top."""
    x0, y0, x1, y1 = boxes.T
    foot = np.stack([np.stack(pair, -1) for pair in ((x0, y0), (x1, y0), (x1, y1), (x0, y1))], 1)
    low = np.concatenate([foot, np.zeros((len(boxes), 4, 1))], -1)
    high = np.concatenate([foot, np.full((len(boxes), 4, 1), height)], -1)
    return np.concatenate([low, high], 1)


def _behind(boxes: Array, ball: Array, eye: Array) -> NDArray[np.bool_]:
    """Which boxes the ball may hide: the plane that parts box and ball has the camera on the ball's side."""
    low, high = boxes[:, :2], boxes[:, 2:]
    gap_above, gap_below = ball - high, low - ball  # (n, 2): the ball lies beyond a face where positive
    gaps = np.concatenate([gap_above, gap_below], 1)
    face = np.argmax(gaps, 1)
    camera = np.concatenate([eye[:2] - high, low - eye[:2]], 1)
    return camera[np.arange(len(boxes)), face] > 0
