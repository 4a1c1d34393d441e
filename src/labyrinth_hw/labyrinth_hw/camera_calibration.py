# SPDX-License-Identifier: Apache-2.0
"""The lens from pictures of a chessboard; the camera's latency from the board's own motion."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from labyrinth_hw.camera import Array, Frame, Intrinsics
from labyrinth_hw.errors import InputError


@dataclass(frozen=True)
class Latency:
    """How much later the camera's stamps are than the encoders'.

    Attributes:
        seconds: subtract it from the camera's stamps.
        spread: its standard error, s, from the curvature of the correlation's peak and the residual's size.
        correlation: of both signals at that shift; 1 is perfect.
        samples: number of camera samples used.
    """

    seconds: float
    spread: float
    correlation: float
    samples: int


def find_chessboard(frame: Frame, inner: tuple[int, int]) -> Array | None:
    """(n, 2) px of the inner corners, row by row, in a BGR or grey picture; None where not all are seen.

    Args:
        inner: inner corners per row and per column.
    """
    grey = frame if frame.ndim == 2 else cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY)
    found, corners = cv2.findChessboardCornersSB(grey, inner, flags=cv2.CALIB_CB_NORMALIZE_IMAGE)
    return np.asarray(corners, float).reshape(-1, 2) if found else None


def calibrate_lens(
    views: Sequence[Array], inner: tuple[int, int], square: float, size: tuple[int, int], latency: float = 0.0
) -> Intrinsics:
    """Intrinsics from at least 5 views of one chessboard (Zhang's method, `cv2.calibrateCamera`).

    Args:
        views: corners as `find_chessboard` gives them.
        inner: inner corners per row and per column. square: side of a square, m.
        size: picture's width and height, px.
    """
    if len(views) < 5:
        raise InputError(
            f"{len(views)} pictures show the whole chessboard with {inner[0]}x{inner[1]} inner corners; at least 5 are "
            "needed, better 20, tilted by some 30 degrees in all directions and reaching into the picture's corners."
        )
    plane = np.zeros((inner[0] * inner[1], 3), np.float32)
    plane[:, :2] = np.mgrid[: inner[0], : inner[1]].T.reshape(-1, 2) * square
    pixels = [np.asarray(view, np.float32).reshape(-1, 1, 2) for view in views]
    error, matrix, bend, _, _ = cv2.calibrateCamera([plane] * len(views), pixels, size, None, None)
    k1, k2, p1, p2, k3 = (float(k) for k in np.ravel(bend)[:5])
    return Intrinsics(
        width=size[0], height=size[1], fx=float(matrix[0, 0]), fy=float(matrix[1, 1]), cx=float(matrix[0, 2]),
        cy=float(matrix[1, 2]), distortion=(k1, k2, p1, p2, k3), latency=latency, residual=float(error),
    )  # fmt: skip


def calibrate_from_frames(
    frames: Iterable[Frame],
    inner: tuple[int, int],
    square: float,
    progress: Callable[[int, int], None] = lambda seen, views: None,
) -> Intrinsics:
    """Intrinsics from pictures or a stream; pictures without the whole chessboard are passed over.

    Args:
        progress: called with (pictures seen, pictures used) after each.
    """
    views: list[Array] = []
    size: tuple[int, int] | None = None
    for seen, frame in enumerate(frames, 1):
        own = (frame.shape[1], frame.shape[0])
        if size not in (None, own):
            raise InputError(f"Pictures differ in size: {size} and {own}. Use one camera mode.")
        size = own
        corners = find_chessboard(frame, inner)
        if corners is not None:
            views.append(corners)
        progress(seen, len(views))
    return calibrate_lens(views, inner, square, size or (0, 0))


def measure_latency(
    camera_time: Array, camera_tilt: Array, encoder_time: Array, encoder_angle: Array, longest: float = 0.25
) -> Latency:
    """The shift at which the tilt that the camera sees follows the encoders' angle best.

    Cross-correlation over shifts from -`longest` to `longest`; gain and offset between both do not matter. The peak is
    refined by a parabola. Both must be stamped by one clock.

    Args:
        camera_time: (n,) s, uncorrected stamps. camera_tilt: (n,) rad, NaN where not seen.
        encoder_time: (k,) s, increasing. encoder_angle: (k,) rad.
    """
    t, tilt = np.asarray(camera_time, float), np.asarray(camera_tilt, float)
    encoder_time, encoder_angle = np.asarray(encoder_time, float), np.asarray(encoder_angle, float)
    if t.shape != tilt.shape or encoder_time.shape != encoder_angle.shape or t.ndim != 1 or encoder_time.ndim != 1:
        raise InputError(
            f"Times and angles must pair up: camera {t.shape} and {tilt.shape}, "
            f"encoder {encoder_time.shape} and {encoder_angle.shape}."
        )
    if len(encoder_time) < 2 or (np.diff(encoder_time) <= 0).any():
        raise InputError("Encoder stamps must increase and be at least two. Look for a clock that stepped back.")
    use = np.isfinite(tilt) & (t - longest >= encoder_time[0]) & (t + longest <= encoder_time[-1])
    t, tilt = t[use], tilt[use]
    if len(t) < 50:
        raise InputError(f"{len(t)} camera samples overlap the encoders' record; at least 50 are needed. Record 10 s.")
    if np.ptp(encoder_angle) < 0.01 or np.std(tilt) < 1e-4:
        raise InputError("The board hardly moved. Tilt it back and forth by a few degrees while recording.")
    shifts = np.arange(-longest, longest + 5e-4, 1e-3)
    scores = np.array([_correlation(tilt, np.interp(t - shift, encoder_time, encoder_angle)) for shift in shifts])
    sign = 1.0 if scores.max() >= -scores.min() else -1.0  # the encoder may count the other way
    scores *= sign
    peak = int(np.argmax(scores))
    if peak in (0, len(shifts) - 1):
        raise InputError(f"The best shift lies at the end of +-{longest:g} s. Do both clocks agree? Move faster.")
    if scores[peak] < 0.8:
        raise InputError(
            f"Camera and encoder correlate by {scores[peak]:.2f} only; 0.8 is the least. Is it the right axis? "
            "Belt slack hides small motions: use larger ones."
        )
    # A parabola over +-5 ms: encoder samples 10 ms apart leave kinks that a three-point fit would follow.
    near = slice(max(peak - 5, 0), peak + 6)
    curve = np.polyfit(shifts[near] - shifts[peak], scores[near], 2)
    best = shifts[peak] - curve[1] / (2 * curve[0]) if curve[0] < 0 else shifts[peak]
    best = float(np.clip(best, shifts[near][0], shifts[near][-1]))
    top = float(np.clip(scores[peak], -1, 1 - 1e-12))
    spread = float(np.sqrt((1 - top**2) / max(len(t) * -2 * curve[0], 1e-12))) if curve[0] < 0 else float("nan")
    return Latency(best, spread, top, len(t))


def with_latency(intrinsics: Intrinsics, latency: Latency) -> Intrinsics:
    """The same lens with the measured latency."""
    return replace(intrinsics, latency=latency.seconds)


def _correlation(a: Array, b: Array) -> float:
    a, b = a - a.mean(), b - b.mean()
    scale = float(np.sqrt((a @ a) * (b @ b)))
    return float(a @ b) / scale if scale > 0 else 0.0
