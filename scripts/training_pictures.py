"""Pictures that the compact feature network learns from, all free or made here.

Photos that ship in the wheels of scikit-image and scikit-learn, renders of the demo's still life,
and procedural ones: dead leaves, noise of many spectra, gratings, glyphs. From those in turn:
brush paintings, splats and collages. None of the development data are used.
"""

import math
from collections.abc import Callable, Iterator

import cv2
import numpy as np
import skimage.data
import torch
from jaxtyping import Float, UInt8
from sklearn.datasets import load_sample_images
from tqdm import tqdm

from still_life.paintings import paint
from still_life.photos import DISTANCE, TARGET, arrange, photograph
from stylesplat.rendering.render import rasterize
from stylesplat.scene.cameras import Cameras, look_at
from stylesplat.scene.splats import SH_C0, Splats

SIZE = 320  # pixels along a side of every picture

Picture = Float[np.ndarray, "S S 3"]
Map = Float[np.ndarray, "S S"]
Maker = Callable[[np.random.Generator, list[Picture]], Picture]

PHOTOS = ("astronaut", "brick", "camera", "chelsea", "coffee", "coins", "colorwheel", "grass")
PHOTOS += ("gravel", "hubble_deep_field", "immunohistochemistry", "page", "retina", "rocket")
FONTS = (cv2.FONT_HERSHEY_COMPLEX, cv2.FONT_HERSHEY_SCRIPT_COMPLEX, cv2.FONT_HERSHEY_SIMPLEX)
LETTERS = "ABCDEFGHKLMNPQRSTUVWXYZabcdefghkmnopqrstuvwxyz0123456789&?!%#@"


def training_pictures(count: int, seed: int) -> UInt8[torch.Tensor, "P S S 3"]:
    """A pool of pictures of many kinds, the same for the same seed."""
    rng = np.random.default_rng(seed)
    firsts = [*_renders(rng, count // 8)]
    photos = shipped_photos()
    firsts += [crop(photos[i % len(photos)], rng) for i in range(count // 4)]
    for make in (dead_leaves, spectrum, gratings, glyphs):
        firsts += [make(rng, firsts) for _ in range(count // 16)]
    pool = list(firsts)
    seconds: tuple[Maker, ...] = (painting, painting, splatted, collage)
    bar = tqdm(range(count - len(pool)), desc="paintings, splats, collages")
    pool += [seconds[i % len(seconds)](rng, firsts) for i in bar]
    return torch.stack([torch.from_numpy(_quantized(picture)) for picture in pool])


def shipped_photos() -> list[Float[np.ndarray, "_ _ 3"]]:
    """The photos in the wheels of scikit-image and scikit-learn, sRGB in 0..1."""
    images = [getattr(skimage.data, name)() for name in PHOTOS]
    images += [*skimage.data.stereo_motorcycle()[:2], *load_sample_images().images]
    colored = [np.atleast_3d(image)[..., :3] for image in images]
    return [np.repeat(c, 3, axis=2) / 255 if c.shape[2] == 1 else c / 255 for c in colored]


def crop(photo: Float[np.ndarray, "_ _ 3"], rng: np.random.Generator) -> Picture:
    """A square part of a photo, larger ones more often, perhaps mirrored or on its side."""
    side = round(min(photo.shape[:2]) * rng.uniform(0.3, 1) ** 0.7)
    row, column = (rng.integers(0, length - side + 1) for length in photo.shape[:2])
    part = np.rot90(photo[row : row + side, column : column + side], rng.choice([0, 0, 0, 1]))
    part = part[:, :: rng.choice([-1, 1])]
    return cv2.resize(np.ascontiguousarray(part), (SIZE, SIZE), interpolation=cv2.INTER_AREA)


def dead_leaves(rng: np.random.Generator, others: list[Picture]) -> Picture:
    """Opaque shapes of all sizes over each other, as objects occlude in photos (Lee et al. 2001).

    Their colours are another picture's; some have a texture.
    """
    colors, texture = _some(rng, others).reshape(-1, 3), _some(rng, others)
    picture = np.ascontiguousarray(colors[rng.integers(len(colors))] + np.zeros((SIZE, SIZE, 3)))
    for _ in range(rng.integers(80, 500)):
        radius = 3 / (1 - 0.96 * rng.random()) ** rng.uniform(0.7, 1.1)
        mask = np.zeros((SIZE, SIZE), np.uint8)
        cv2.fillPoly(mask, [_shape(rng, radius)], 255, cv2.LINE_AA)
        fill = colors[rng.integers(len(colors))] + np.zeros((SIZE, SIZE, 3))
        if rng.random() < 0.3:
            fill = (fill + 1.5 * (texture - texture.mean())).clip(0, 1)
        picture += (mask / 255)[..., None] * (fill - picture)
    return picture


def spectrum(rng: np.random.Generator, others: list[Picture]) -> Picture:
    """Noise whose amplitude falls with a power of the frequency, in another picture's colours."""
    rows, columns = np.fft.fftfreq(SIZE)[:, None], np.fft.rfftfreq(SIZE)[None]
    stretch, turn = rng.uniform(0.3, 1), rng.uniform(0, math.pi)
    u = np.cos(turn) * rows + np.sin(turn) * columns
    v = stretch * (np.cos(turn) * columns - np.sin(turn) * rows)
    amplitude = (np.hypot(u, v) + 1 / SIZE) ** -rng.uniform(0.3, 2.2)
    noise = rng.normal(size=(3, *amplitude.shape)) + 1j * rng.normal(size=(3, *amplitude.shape))
    planes = np.fft.irfft2(noise * amplitude, (SIZE, SIZE))
    planes /= planes.std(axis=(1, 2), keepdims=True)
    return _colored(planes.transpose(1, 2, 0), _some(rng, others))


def gratings(rng: np.random.Generator, others: list[Picture]) -> Picture:
    """Bent waves of one to three directions, soft or hard, in two colours or more."""
    x, y = np.meshgrid(*2 * [np.arange(SIZE)])
    bend = cv2.resize(rng.normal(size=(2, 5, 5)).transpose(1, 2, 0), (SIZE, SIZE), interpolation=2)
    x, y = x + rng.uniform(0, 30) * bend[..., 0], y + rng.uniform(0, 30) * bend[..., 1]
    planes = np.zeros((SIZE, SIZE, 3))
    for _ in range(rng.integers(1, 4)):
        angle, period = rng.uniform(0, math.pi), np.exp(rng.uniform(math.log(3), math.log(60)))
        wave = np.sin(2 * math.pi * (np.cos(angle) * x + np.sin(angle) * y) / period)
        planes += np.tanh(wave * rng.choice([0.7, 6]))[..., None] * rng.normal(size=3)
    return _colored(planes, _some(rng, others))


def glyphs(rng: np.random.Generator, others: list[Picture]) -> Picture:
    """Letters, lines and rings of many sizes over a flat ground or another picture."""
    colors = _some(rng, others).reshape(-1, 3)
    ground = colors[rng.integers(len(colors))] + np.zeros((SIZE, SIZE, 3))
    picture = _quantized(ground if rng.random() < 0.6 else _some(rng, others))
    for _ in range(rng.integers(15, 150)):
        color = (255 * colors[rng.integers(len(colors))]).tolist()
        at, to = (tuple(rng.integers(-20, SIZE + 20, 2).tolist()) for _ in range(2))
        width, kind = int(rng.integers(1, 9)), rng.random()
        if kind < 0.6:
            letters = "".join(rng.choice([*LETTERS], rng.integers(1, 5)))
            font = FONTS[rng.integers(len(FONTS))]
            cv2.putText(picture, letters, at, font, rng.uniform(0.4, 5), color, width, cv2.LINE_AA)
        elif kind < 0.8:
            cv2.line(picture, at, to, color, width, cv2.LINE_AA)
        else:
            cv2.circle(picture, at, int(rng.integers(3, 70)), color, width, cv2.LINE_AA)
    return picture / 255


def painting(rng: np.random.Generator, others: list[Picture]) -> Picture:
    """Another picture in strokes of the demo's brush, along its contours or a field of whirls."""
    cartoon = cv2.GaussianBlur(_some(rng, others), (0, 0), rng.uniform(1, 6))
    potential = cv2.resize(rng.random((6, 6)), (SIZE, SIZE), interpolation=cv2.INTER_CUBIC) * 2
    potential += rng.uniform(0, 1.5) * cv2.GaussianBlur(cartoon, (0, 0), 5).mean(axis=2)
    along_y, along_x = np.gradient(potential)
    field = np.stack([along_y, -along_x], axis=-1)
    width = rng.uniform(2.5, 10)
    layers = [_strokes(rng, cartoon, width / shrink) for shrink in (1, 1.7, 2.8)]
    return paint(cartoon * rng.uniform(0.3, 1), field, np.concatenate(layers)) / 255


def splatted(rng: np.random.Generator, others: list[Picture]) -> Picture:
    """Another picture as a cloud of Gaussians, as the renders are that styles are matched on."""
    picture, count = _some(rng, others), int(rng.integers(1500, 12000))
    places = rng.random((count, 3))
    row, column = (SIZE * places[:, :2]).astype(int).T
    colors = picture[row, column] + rng.normal(0, rng.uniform(0, 0.15), (count, 3))
    means = (places[:, ::-1] - 0.5) * [0.3, 1, 1]  # depth, x, y
    sizes = np.log(1.2 / math.sqrt(count)) + rng.normal(0, 0.5, (count, 3)) - 0.4
    splats = Splats(
        means=_tensor(means[:, [1, 2, 0]] + [0, 0, 1.0]),
        quats=_tensor(rng.normal(size=(count, 4))),
        scales=_tensor(sizes),
        opacities=_tensor(rng.normal(1, 1.5, count)),
        sh0=_tensor((colors - 0.5) / SH_C0)[:, None],
        shN=torch.zeros(count, 0, 3),
    )
    K = torch.tensor([[SIZE, 0, SIZE / 2], [0, SIZE, SIZE / 2], [0, 0, 1.0]])
    camera = Cameras(torch.eye(4)[None], K[None], torch.tensor([[SIZE, SIZE]]), ("splat",))
    image, _, _ = rasterize(splats, camera, background=torch.tensor(picture.mean((0, 1))).float())
    return image[0].numpy().clip(0, 1).astype(np.float64)


def collage(rng: np.random.Generator, others: list[Picture]) -> Picture:
    """Two pictures, one in the blots of a mask."""
    one, other = _some(rng, others), _some(rng, others)
    cells = int(rng.integers(3, 12))
    blots = cv2.resize(rng.random((cells, cells)), (SIZE, SIZE), interpolation=cv2.INTER_CUBIC)
    share = (0.5 + (blots - 0.5) * rng.uniform(2, 40)).clip(0, 1)[..., None]
    return one + share * (other - one)


def _renders(rng: np.random.Generator, count: int) -> Iterator[Picture]:
    """The demo's still life, from anywhere around it, in other arrangements and light."""
    for number in tqdm(range(count), desc="renders"):
        tilt, turn = rng.uniform(0.15, 1.1), rng.uniform(0, 2 * math.pi)
        outward = [math.cos(tilt) * math.cos(turn), math.cos(tilt) * math.sin(turn), math.sin(tilt)]
        target = torch.tensor(TARGET) + 0.3 * torch.tensor(rng.normal(size=3)).float()
        position = target + DISTANCE * rng.uniform(0.5, 1.1) * torch.tensor(outward)
        focal = rng.uniform(1, 2.2) * SIZE
        K = torch.tensor([[focal, 0, SIZE / 2], [0, focal, SIZE / 2], [0, 0, 1]])
        viewmats = look_at(position[None], target, torch.tensor([0.0, 0.0, 1.0]))
        camera = Cameras(viewmats, K[None].float(), torch.tensor([[SIZE, SIZE]]), ("render",))
        (view,) = photograph(camera, arrange(number + 1))
        yield view.photo.numpy() / 255


def _shape(rng: np.random.Generator, radius: float) -> np.ndarray:
    """A rounded or angular outline somewhere in the picture."""
    corners = int(rng.choice([3, 4, 5, 24]))
    angles = np.linspace(0, 2 * math.pi, corners, endpoint=False) + rng.uniform(0, 6)
    reach = radius * rng.uniform(0.7, 1, corners) if corners < 24 else np.full(corners, radius)
    outline = np.stack([np.cos(angles) * reach, np.sin(angles) * reach * rng.uniform(0.3, 1)], 1)
    turn = rng.uniform(0, math.pi)
    spin = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    return (outline @ spin + rng.uniform(0, SIZE, 2)).round().astype(np.int32)


def _strokes(rng: np.random.Generator, cartoon: Picture, half_width: float) -> np.ndarray:
    """One layer of strokes as `paint` takes them, enough to cover the picture."""
    length = half_width * rng.uniform(2, 9)
    count = int(1.5 * SIZE**2 / (2 * half_width * length))
    x, y = rng.uniform(0, SIZE, (2, count))
    colors = cartoon[y.astype(int), x.astype(int)] * rng.normal(1, 0.1, (count, 1))
    sizes = rng.uniform(0.7, 1.3, (count, 2)) * (length, half_width)
    return np.column_stack([x, y, sizes, colors.clip(0, 1), rng.uniform(0, 500, count)])


def _colored(planes: Picture, like: Picture) -> Picture:
    """Planes in the mean and covariance of another picture's colours."""
    pixels = like.reshape(-1, 3)
    values, vectors = np.linalg.eigh(np.cov(pixels.T) + 1e-4 * np.eye(3))
    mixed = planes @ (vectors * np.sqrt(values)).T
    return (mixed + pixels.mean(axis=0)).clip(0, 1)


def _some(rng: np.random.Generator, pictures: list[Picture]) -> Picture:
    return pictures[rng.integers(len(pictures))].copy()


def _tensor(array: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(np.ascontiguousarray(array)).float()


def _quantized(picture: Picture) -> UInt8[np.ndarray, "S S 3"]:
    return (picture.clip(0, 1) * 255).round().astype(np.uint8)
