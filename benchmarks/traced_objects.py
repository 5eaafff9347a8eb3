"""Two test objects that no photo shows: a face, and a sign on thin legs. Traced like the demo.

Both are signed distance fields that stand at the origin of the demo's table and face +x, seen by
cameras on an arc in front of them. The object has label 1; label maps are exact. To write one as a
capture: `python benchmarks/traced_objects.py --shape face --folder DIR`.
"""

from math import exp, sin, sqrt
from pathlib import Path
from typing import Literal

import bench  # noqa: F401  (still_life is found then)
import cv2
import numba
import numpy as np
import torch
import tyro
from jaxtyping import Float
from torch import Tensor

from still_life.nerfstudio import write_transforms
from still_life.objects import smooth_max, smooth_min
from still_life.photos import View, surface_points
from still_life.surroundings import backdrop_albedo, hit_backdrop, hit_table, table_albedo
from still_life.tracer import AO_TAPS, BOUNCE, LIGHT, SKYLIGHT
from still_life.vectors import (
    FAST,
    Vec,
    along,
    dot,
    fractal_noise,
    kernel,
    length,
    mix,
    noise,
    product,
    saturate,
    scaled,
    smoothstep,
    unit,
)
from stylesplat.io.atomic import atomic_folder
from stylesplat.io.captures.capture_folder import OBJECT_MASK
from stylesplat.io.images import write_image
from stylesplat.io.label_maps import write_label_map
from stylesplat.progress import track
from stylesplat.scene.cameras import Cameras, look_at

Shape = Literal["face", "sign"]
SHAPES: tuple[Shape, ...] = ("face", "sign")
FACE, SIGN = 0, 1

TEXT = ("CAFE", "OPEN 7")
PLATE = (0.30, 0.17, 0.86)  # half width, half height, height of the centre
PLATE_X = 0.02  # half thickness

VIEWS, WIDTH, HEIGHT = 32, 520, 600
TARGET, DISTANCE, FOCAL = (0.0, 0.0, 0.60), 2.6, 1.5  # of the photo's height
TURN = 100.0  # degrees: the farthest that a camera stands to the side
ELEVATION, SWAY = 15.0, 12.0  # degrees
POINTS = 20_000

BOUND = (0.6, 0.85)  # height of the centre and radius of a sphere around either object
HIT = 4e-4
STEPS = 160
TO_LIGHT = (0.58, -0.50, 0.643)  # from the front: a face that is lit from behind cannot be read

SKIN, BLUSH, LIP, HAIR = (
    (0.70, 0.42, 0.28),
    (0.62, 0.24, 0.17),
    (0.42, 0.06, 0.06),
    (0.06, 0.03, 0.015),
)
WHITE, IRIS, BLACK = (0.86, 0.84, 0.80), (0.05, 0.16, 0.22), (0.008, 0.006, 0.006)
SHIRT = (0.06, 0.14, 0.30)
PAINT, LETTERS, STEEL, RED = (
    (0.78, 0.70, 0.50),
    (0.03, 0.07, 0.20),
    (0.05, 0.05, 0.055),
    (0.50, 0.04, 0.03),
)


@kernel
def _ellipsoid(p: Vec, centre: Vec, axes: Vec) -> float:
    x, y, z = (
        (p[0] - centre[0]) / axes[0],
        (p[1] - centre[1]) / axes[1],
        (p[2] - centre[2]) / axes[2],
    )
    outside = length((x, y, z))
    return outside * (outside - 1) / (length((x / axes[0], y / axes[1], z / axes[2])) + 1e-9)


@kernel
def _rod(p: Vec, start: Vec, end: Vec, radius: float, end_radius: float) -> float:
    axis, offset = along(end, start, -1.0), along(p, start, -1.0)
    t = saturate(dot(offset, axis) / dot(axis, axis))
    return length(along(offset, axis, -t)) - (radius + (end_radius - radius) * t)


@kernel
def _face(p: Vec) -> float:
    """A bust: the mirror image of its left half."""
    q = (p[0], abs(p[1]), p[2])
    head = _ellipsoid(q, (-0.03, 0.0, 0.86), (0.335, 0.275, 0.335))
    head = smooth_min(head, _ellipsoid(q, (0.07, 0.0, 0.69), (0.235, 0.205, 0.255)), 0.10)
    head = smooth_min(head, _ellipsoid(q, (0.24, 0.0, 0.505), (0.07, 0.085, 0.06)), 0.10)
    head = smooth_min(head, _ellipsoid(q, (0.19, 0.115, 0.70), (0.10, 0.08, 0.08)), 0.08)
    head = smooth_max(head, -_ellipsoid(q, (0.36, 0.115, 0.815), (0.09, 0.085, 0.05)), 0.06)
    head = smooth_min(head, _rod(q, (0.285, 0.03, 0.895), (0.245, 0.17, 0.89), 0.022, 0.012), 0.05)
    head = smooth_min(head, _ellipsoid(q, (0.215, 0.115, 0.815), (0.07, 0.075, 0.056)), 0.015)
    head = smooth_min(head, _rod(q, (0.285, 0.0, 0.86), (0.375, 0.0, 0.715), 0.022, 0.036), 0.05)
    head = smooth_min(head, _ellipsoid(q, (0.335, 0.042, 0.70), (0.040, 0.026, 0.024)), 0.03)
    head = smooth_min(head, _ellipsoid(q, (0.280, 0.0, 0.625), (0.045, 0.075, 0.016)), 0.025)
    head = smooth_min(head, _ellipsoid(q, (0.270, 0.0, 0.590), (0.048, 0.062, 0.018)), 0.02)
    head = smooth_min(head, _ellipsoid(q, (-0.02, 0.275, 0.775), (0.055, 0.03, 0.085)), 0.03)
    neck = _rod(q, (-0.07, 0.0, 0.15), (-0.03, 0.0, 0.55), 0.15, 0.125)
    bust = _ellipsoid(q, (-0.05, 0.0, 0.08), (0.24, 0.42, 0.22))
    return smooth_max(smooth_min(head, smooth_min(neck, bust, 0.12), 0.06), -p[2], 0.02)


@kernel
def _face_albedo(p: Vec) -> Vec:
    """Skin, hair and shirt; eyes, brows and mouth painted as seen from the front."""
    side, z, front = abs(p[1]), p[2], p[0] > 0.05
    grain = fractal_noise(scaled(p, 14), 2) - 0.5
    skin = scaled(SKIN, 1 + 0.06 * grain)
    cheek = exp(-((side - 0.135) ** 2 + (z - 0.675) ** 2) / 0.0035)
    color = mix(skin, BLUSH, 0.45 * cheek * front)
    if front:
        lips = 1 - (side / 0.088) ** 2
        upper, lower = 0.022 * lips - 0.005 * exp(-((side / 0.014) ** 2)), 0.034 * lips
        height = z - 0.608
        mouth = smoothstep(-0.003, 0.003, min(upper - height, height + lower)) * (side < 0.088)
        color = mix(color, LIP, 0.85 * mouth)
        seam = smoothstep(0.006, 0.002, abs(height)) * (side < 0.082)
        color = mix(color, scaled(LIP, 0.15), seam)
        nostril = ((side - 0.027) / 0.013) ** 2 + ((z - 0.681) / 0.008) ** 2
        color = mix(color, scaled(LIP, 0.2), 0.8 * smoothstep(1.3, 0.7, nostril) * (p[0] > 0.3))
        arch = 0.893 + 0.022 * sin((side - 0.045) / 0.15 * 3.1) - 0.02 * (side - 0.05)
        brow = 0.015 - 0.008 * (side - 0.045) / 0.15 - abs(z - arch)
        color = mix(color, HAIR, 0.95 * smoothstep(-0.003, 0.003, brow) * (0.045 < side < 0.195))
        color = _eye(color, (side - 0.115) / 0.062, (z - 0.812) / 0.062)
    line = 0.995 - 0.5 * side * side - 0.62 * (0.28 - p[0]) + 0.008 * sin(side * 60)
    waves = 0.5 + 0.5 * sin(p[1] * 90 + 6 * noise(scaled(p, 9)))
    hair = scaled(HAIR, 0.6 + 1.3 * waves)
    line = max(line, 0.56)
    ear = smoothstep(0.11, 0.07, sqrt((p[0] + 0.02) ** 2 + (z - 0.775) ** 2)) * (side > 0.262)
    color = mix(color, hair, smoothstep(-0.006, 0.006, z - line) * (1 - ear))
    return mix(SHIRT, color, smoothstep(0.262, 0.268, z + 0.16 * (p[0] > 0) * p[0] - 0.1 * side))


@kernel
def _eye(skin: Vec, u: float, v: float) -> Vec:
    """An almond with iris, pupil, glint and lashes; -1 to 1 from corner to corner."""
    if abs(u) > 1.12:
        return skin
    arc = max(1 - u * u, 0.0)
    upper, lower = 0.50 * arc, -0.36 * arc
    inside = min(upper - v, v - lower)
    radius = sqrt(u * u + (v - 0.06) ** 2)
    eye = mix(IRIS, WHITE, smoothstep(0.40, 0.45, radius))
    eye = mix(BLACK, eye, smoothstep(0.17, 0.22, radius))
    glint = (u + 0.13) ** 2 + (v - 0.22) ** 2
    eye = mix(WHITE, eye, smoothstep(0.004, 0.010, glint))
    color = mix(skin, eye, smoothstep(-0.03, 0.03, inside))
    lash = smoothstep(0.11, 0.05, abs(v - upper - 0.02)) * (abs(u) < 1.05)
    color = mix(color, BLACK, 0.95 * lash)
    fold = smoothstep(0.06, 0.02, abs(v - upper - 0.26)) * (abs(u) < 0.95)
    return mix(color, scaled(BLUSH, 0.55), 0.6 * fold)


@kernel
def _sign(p: Vec) -> float:
    """A plate with a rim on four thin legs with rungs."""
    q = (abs(p[0]), abs(p[1]), p[2])
    dy, dz = q[1] - PLATE[0] + 0.03, abs(p[2] - PLATE[2]) - PLATE[1] + 0.03
    flat = length((max(dy, 0.0), max(dz, 0.0), 0.0)) + min(max(dy, dz), 0.0) - 0.03
    plate = smooth_max(flat, q[0] - PLATE_X, 0.012)
    rim = sqrt(flat * flat + max(q[0] - 0.008, 0.0) ** 2) - 0.016
    legs = _rod(q, (0.0, 0.25, 0.72), (0.24, 0.31, 0.0), 0.017, 0.012)
    rung = _rod(q, (0.13, 0.0, 0.32), (0.13, 0.282, 0.32), 0.009, 0.009)
    brace = _rod(q, (0.0, 0.297, 0.16), (0.188, 0.297, 0.16), 0.009, 0.009)
    finial = length((p[0], p[1], p[2] - PLATE[2] - PLATE[1] - 0.035)) - 0.03
    frame = min(min(legs, rung), min(brace, smooth_min(rim, finial, 0.03)))
    return max(min(plate, frame), -p[2])


@kernel
def _sign_albedo(p: Vec, text: np.ndarray) -> Vec:
    """Letters on both sides of the plate; steel legs with red rungs."""
    y, z = p[1], p[2] - PLATE[2]
    if abs(y) < PLATE[0] - 0.012 and abs(z) < PLATE[1] - 0.012 and abs(p[0]) < PLATE_X + 0.01:
        u = 0.5 + 0.5 * (y if p[0] > 0 else -y) / PLATE[0]
        row = int((0.5 - 0.5 * z / PLATE[1]) * text.shape[0])
        column = int(u * text.shape[1])
        worn = 0.85 + 0.3 * fractal_noise(scaled(p, 20), 3)
        return scaled(mix(PAINT, LETTERS, text[row, column]), worn)
    rung = abs(p[2] - 0.32) < 0.011 or abs(p[2] - 0.16) < 0.011
    return RED if rung or (abs(z) > PLATE[1] + 0.018 and p[2] > 0.8) else STEEL


@kernel
def _distance(shape: int, p: Vec) -> float:
    return 0.9 * _face(p) if shape == FACE else _sign(p)


@kernel
def _march(origin: Vec, direction: Vec, shape: int, start: float) -> tuple[float, float]:
    """Where a ray hits the object, 1e9 if it does not; and how near to a shadow's edge it went."""
    centre = (0.0, 0.0, BOUND[0])
    offset = along(origin, centre, -1.0)
    b = dot(offset, direction)
    root = b * b - dot(offset, offset) + BOUND[1] ** 2
    if root <= 0:
        return 1e9, 1.0
    t, leave, light = max(-b - sqrt(root), start), -b + sqrt(root), 1.0
    for _ in range(STEPS):
        if t > leave:
            break
        d = _distance(shape, along(origin, direction, t))
        if d < HIT:
            return t, 0.0
        light = min(light, 7.0 * d / t)
        t += d
    return 1e9, light


@kernel
def _normal(shape: int, p: Vec) -> Vec:
    n = (0.0, 0.0, 0.0)
    for k in range(4):
        corner = (-1.0 + 2 * ((k ^ (k >> 1)) & 1), -1.0 + 2 * (k >> 1), -1.0 + 2 * (k & 1))
        n = along(n, corner, _distance(shape, along(p, corner, 1e-3)))
    return unit(n)


@kernel
def _look(origin: Vec, direction: Vec, shape: int, text: np.ndarray) -> tuple[float, int, Vec]:
    """How far a ray goes, whether it ends on the object, and the light that comes back."""
    t, _ = _march(origin, direction, shape, 0.0)
    far, table = hit_backdrop(origin, direction), hit_table(origin, direction)
    if min(t, table) > far:
        return far, 0, scaled(backdrop_albedo(along(origin, direction, far)), 0.6)
    hit = int(t < table)
    t = min(t, table)
    p = along(origin, direction, t)
    n = (0.0, 0.0, 1.0)
    color = table_albedo(p, 3.0)
    if hit:
        n = _normal(shape, p)
        color = _face_albedo(p) if shape == FACE else _sign_albedo(p, text)
    _, shadow = _march(along(p, n, 0.006), TO_LIGHT, shape, 0.01)
    lit = max(dot(n, TO_LIGHT), 0.0) * shadow
    blocked, weight = 0.0, 1.0
    for reach in AO_TAPS:
        q = along(p, n, reach)
        free = min(max(_distance(shape, q), 0.0), max(q[2], 0.0), reach)
        blocked += weight * (reach - free) / reach
        weight *= 0.8
    ambient = scaled(mix(BOUNCE, SKYLIGHT, 0.5 + 0.5 * n[2]), 1 - 0.8 * saturate(blocked / 3.36))
    light = along(ambient, LIGHT, 0.75 * lit)
    halfway = unit(along(TO_LIGHT, direction, -1.0))
    shine = 0.12 * hit * lit * max(dot(n, halfway), 0.0) ** 32
    return t, hit, along(product(color, light), LIGHT, shine)


@kernel
def _film(x: float) -> float:
    """Linear light to display value: Narkowicz's fit of the ACES curve, then gamma."""
    x = 0.55 * max(x, 0.0)
    return saturate(x * (2.51 * x + 0.03) / (x * (2.43 * x + 0.59) + 0.14)) ** (1 / 2.2)


@numba.njit(**FAST, parallel=True)
def _photograph(
    shape: int,
    K: np.ndarray,
    c2w: np.ndarray,
    text: np.ndarray,
    photo: np.ndarray,
    geometry: np.ndarray,
) -> None:
    """Colours of a photo, the mean of four samples a pixel; label and depth at its centre."""
    origin = (c2w[0, 3], c2w[1, 3], c2w[2, 3])
    for row in numba.prange(photo.shape[0]):
        for column in range(photo.shape[1]):
            color = (0.0, 0.0, 0.0)
            for sample in range(5):
                x, y = column + 0.5, row + 0.5
                if sample < 4:
                    x, y = x - 0.25 + 0.5 * (sample & 1), y - 0.25 + 0.5 * (sample >> 1)
                u, v = (x - K[0, 2]) / K[0, 0], (y - K[1, 2]) / K[1, 1]
                ray = (
                    c2w[0, 0] * u + c2w[0, 1] * v + c2w[0, 2],
                    c2w[1, 0] * u + c2w[1, 1] * v + c2w[1, 2],
                    c2w[2, 0] * u + c2w[2, 1] * v + c2w[2, 2],
                )
                t, hit, seen = _look(origin, unit(ray), shape, text)
                if sample < 4:
                    color = along(color, (_film(seen[0]), _film(seen[1]), _film(seen[2])), 0.25)
                else:
                    geometry[row, column, 0] = hit
                    geometry[row, column, 1] = t / length(ray)
            for channel in range(3):
                photo[row, column, channel] = color[channel]


def arc(views: int = VIEWS) -> Cameras:
    """Cameras that go to and fro in front of the object, higher one way than the other.

    Every eighth is held out by training: two near the middle and two at the sides.
    """
    phases = torch.arange(views) / views + 1 / 16
    turns = torch.deg2rad(TURN * (1 - 4 * ((phases + 0.25) % 1 - 0.5).abs()))
    tilts = torch.deg2rad(ELEVATION + SWAY * (2 * np.pi * phases).cos())
    outward = torch.stack(
        [tilts.cos() * turns.cos(), tilts.cos() * turns.sin(), tilts.sin()], dim=1
    )
    target = torch.tensor(TARGET)
    focal = FOCAL * HEIGHT
    K = torch.tensor([[focal, 0, WIDTH / 2], [0, focal, HEIGHT / 2], [0, 0, 1]])
    return Cameras(
        viewmats=look_at(target + DISTANCE * outward, target, torch.tensor([0.0, 0.0, 1.0])),
        Ks=K.expand(views, 3, 3).clone(),
        sizes=torch.tensor([[WIDTH, HEIGHT]]).expand(views, 2).clone(),
        names=tuple(f"{i:03d}.png" for i in range(views)),
    )


def photograph(shape: Shape, camera: Cameras) -> View:
    """What one camera sees."""
    width, height = camera.size
    photo, geometry = (
        np.empty((height, width, 3), np.float32),
        np.empty((height, width, 2), np.float32),
    )
    c2w = camera.viewmats[0].double().inverse().numpy()
    K = camera.Ks[0].double().numpy()
    _photograph(SHAPES.index(shape), K, c2w, letters().numpy(), photo, geometry)
    return View(
        photo=torch.from_numpy((photo * 255).round().astype(np.uint8)),
        labels=torch.from_numpy(geometry[..., 0].astype(np.int64)),
        depth=torch.from_numpy(geometry[..., 1].copy()),
    )


def letters() -> Float[Tensor, "H W"]:
    """The plate's text, 1 where there is ink."""
    width = 900
    ink = np.zeros((round(width * PLATE[1] / PLATE[0]), width), np.uint8)
    font = cv2.FONT_HERSHEY_DUPLEX
    for row, (line, size) in enumerate(zip(TEXT, (6.2, 4.4), strict=True)):
        (wide, tall), _ = cv2.getTextSize(line, font, size, 22)
        place = ((width - wide) // 2, (170 if row == 0 else 395) + tall // 2)
        cv2.putText(ink, line, place, font, size, (255,), 22, cv2.LINE_AA)
    return torch.from_numpy(ink) / 255


def write_traced_capture(shape: Shape, folder: Path) -> Path:
    """Photos, cameras, exact label maps and sparse points of an object, as a capture."""
    cameras = arc()
    with atomic_folder(folder, overwrite=False, marker="transforms.json") as new:
        views = [photograph(shape, cameras[i]) for i in track(range(len(cameras)), shape)]
        for name, view in zip(cameras.names, views, strict=True):
            write_image(view.photo, new / "images" / name)
            write_label_map(view.labels, new / OBJECT_MASK / name)
        points, colors = surface_points(cameras, views, POINTS)
        write_transforms(cameras, new, points=points, point_colors=colors)
    return folder


if __name__ == "__main__":
    tyro.cli(write_traced_capture, description=__doc__)
