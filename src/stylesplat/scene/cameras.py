"""The `Cameras` noun: undistorted pinhole cameras with names; where they stand and look."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from stylesplat.errors import StyleSplatError, count_noun, join_names, noun_repr

MOSTLY_SIDEWAYS = 2 / 3  # of the squares of x axes along one direction: .5 on a level circle
WALKED_OVER = math.radians(225)  # of views, in a plane: over something and beneath it
UPRIGHT = 0.5  # length of the mean y axis: .8 to 1 of photos held upright, .48 at most of others
UP_RIDGE = 0.01  # weight of the cameras' mean up axis against their level axes
# Mean squared sine between view axes (about 2 degrees) below which they never meet
CAMERA_PARALLEL = 1e-3
ROTATION_TOLERANCE = 1e-3  # of an entry of R R^T; files round poses to six digits or so
CAMERA_REMEDY = "To render, choose --views all; to train, give sparse points."


@dataclass(frozen=True, eq=False)
class Cameras:
    """C pinhole cameras in OpenCV axes; pixel centres lie at +0.5."""

    viewmats: Float[Tensor, "C 4 4"]
    """World to camera."""
    Ks: Float[Tensor, "C 3 3"]
    """Intrinsics in pixels."""
    sizes: Int[Tensor, "C 2"]
    """Width and height in pixels."""
    names: tuple[str, ...]
    """The image's file name of each camera."""

    def __repr__(self) -> str:
        return noun_repr(
            self, count_noun(len(self), "view"), pixels(self.sizes), join_names(self.names)
        )

    def __len__(self) -> int:
        return len(self.names)

    def __getitem__(self, index: int | slice | Sequence[int]) -> "Cameras":
        if isinstance(index, int):
            index = [index]
        every = range(len(self))
        rows = [*every[index]] if isinstance(index, slice) else [every[row] for row in index]
        names = tuple(self.names[row] for row in rows)
        return Cameras(self.viewmats[rows], self.Ks[rows], self.sizes[rows], names)

    def __iter__(self) -> Iterator["Cameras"]:
        """The cameras one by one."""
        return (self[row] for row in range(len(self)))

    def __add__(self, other: "Cameras") -> "Cameras":
        viewmats = torch.cat([self.viewmats, other.viewmats])
        Ks, sizes = torch.cat([self.Ks, other.Ks]), torch.cat([self.sizes, other.sizes])
        return Cameras(viewmats, Ks, sizes, self.names + other.names)

    @property
    def size(self) -> tuple[int, int]:
        """The width and height that all cameras share.

        Raises:
            StyleSplatError: If the cameras differ in size.
        """
        sizes = {(w, h) for w, h in self.sizes.tolist()}
        if len(sizes) != 1:
            raise StyleSplatError(
                f"Expected cameras of one size, got {sorted(sizes)}. Render them one by one."
            )
        return sizes.pop()

    @property
    def positions(self) -> Float[Tensor, "C 3"]:
        """Camera centres in the world."""
        rotations = self.viewmats[:, :3, :3]
        return -torch.einsum("cji,cj->ci", rotations, self.viewmats[:, :3, 3])

    def index(self, name: str) -> int:
        """The row of the camera of this file name.

        The extension may be left out or be another one, and so may folders if one file alone has
        that name.

        Raises:
            StyleSplatError: If no camera, or more than one, has that name.
        """
        return find_name(name, self.names)

    def downscale(self, factor: float | int) -> "Cameras":
        """The same cameras for images `factor` times smaller, sizes rounded to whole pixels.

        Raises:
            StyleSplatError: If the factor is not a positive number.
        """
        if not 0 < factor < math.inf:
            raise StyleSplatError(f"Cannot downscale by {factor}. Give a positive factor.")
        if factor == 1:
            return self
        sizes = (self.sizes / factor).round().clamp(min=1)
        ratio = sizes / self.sizes  # [C, 2]
        Ks = self.Ks.clone()
        Ks[:, :2] *= ratio[:, :, None].to(Ks)
        return replace(self, Ks=Ks, sizes=sizes.to(self.sizes.dtype))

    def resize(self, width: int, height: int) -> "Cameras":
        """Cameras for images of another size in pixels that show all of these images, centred."""
        wanted = torch.tensor([width, height])
        factor = (wanted / self.sizes).amin(dim=1).to(self.Ks)  # [C]
        Ks = self.Ks * torch.stack([factor, factor, torch.ones_like(factor)], dim=1)[:, :, None]
        shift = (wanted.to(Ks) - factor[:, None] * self.sizes.to(Ks)) / 2
        Ks[:, :2, 2] += shift
        return replace(self, Ks=Ks, sizes=wanted.to(self.sizes.dtype).repeat(len(self), 1))

    def crop(
        self, corner: Sequence[int | float], size: Sequence[int], *, zoom: float = 1.0
    ) -> "Cameras":
        """The camera of a crop of one camera's image, enlarged by `zoom`.

        `corner` is the left and the top in the camera's pixels, possibly outside its image; `size`
        the width and height in the crop's own pixels.
        """
        Ks = self.Ks.clone()
        Ks[:, :2, 2] -= Ks.new_tensor(corner)
        Ks[:, :2] *= zoom
        return replace(self, Ks=Ks, sizes=torch.tensor([size], dtype=self.sizes.dtype))

    def shrink_to(self, length: int) -> float:
        """The factor by which to downscale so that no side is longer than this, in pixels."""
        return max(1.0, float(self.sizes.max()) / length)

    def at_most(self, length: int) -> "Cameras":
        """The same cameras, downscaled so that no side is longer than this, in pixels."""
        return self.downscale(self.shrink_to(length))

    def to(self, device: torch.device | str) -> "Cameras":
        """The same cameras on another device; `sizes` stay on the CPU."""
        return replace(self, viewmats=self.viewmats.to(device), Ks=self.Ks.to(device))


def find_name(name: str, names: Sequence[str], *, shown_names: Sequence[str] | None = None) -> int:
    """The row of a photo's name as in `Cameras.index`; messages contain the `shown_names`."""
    if name in names:
        return names.index(name)
    stems = [n.rsplit(".", 1)[0] for n in names]
    bare = [stem.rsplit("/", 1)[-1] for stem in stems]
    for known in (stems, bare):
        for stem in (name, name.rsplit(".", 1)[0]):
            if known.count(stem) == 1:
                return known.index(stem)
    known = names if shown_names is None else shown_names
    alike = {each.casefold(): each for each in known}
    near = get_close_matches(name.casefold(), alike, n=1)
    hint = f"Did you mean {alike[near[0]]!r}? " if near else ""
    raise StyleSplatError(
        f"No view is called {name!r}. {hint}Views: {', '.join(known[:8])}"
        f"{', ...' if len(known) > 8 else '.'}"
    )


def are_rigid(
    viewmats: Float[Tensor, "C 4 4"], tolerance: float = ROTATION_TOLERANCE
) -> Bool[Tensor, " C"]:
    """Which poses are finite in 32 bits and consist of a rotation and a shift."""
    rotations = viewmats[:, :3, :3]
    error = rotations @ rotations.mT - torch.eye(3).to(viewmats)
    turned = (error.abs() < tolerance).flatten(1).all(dim=1)
    return (
        turned
        & (torch.linalg.det(rotations) > 0)
        & viewmats.float().isfinite().flatten(1).all(dim=1)
    )


def focus_point(cameras: Cameras) -> Float[Tensor, "3"]:
    """The point nearest to all view axes, in the least-squares sense.

    Raises a StyleSplatError if the axes are parallel, or most cameras look away from the point.
    """
    directions = cameras.viewmats[:, 2, :3].double()
    positions = cameras.positions.double()
    projectors = torch.eye(3).double() - directions[:, :, None] * directions[:, None]  # [C, 3, 3]
    matrix = projectors.mean(dim=0)
    if torch.linalg.eigvalsh(matrix)[0] < CAMERA_PARALLEL:
        raise StyleSplatError(
            f"The cameras all look the same way, so they have no point in common. {CAMERA_REMEDY}"
        )
    focus = torch.linalg.solve(
        matrix, torch.einsum("cij,cj->i", projectors, positions) / len(cameras)
    )
    if ((focus - positions) * directions).sum(dim=-1).median() <= 0:
        raise StyleSplatError(
            f"The cameras look outwards, so they have no point in common. {CAMERA_REMEDY}"
        )
    return focus


def up_vector(cameras: Cameras) -> Float[Tensor, "3"]:
    """The up direction, whether photos were held upright or lie on their side."""
    up = side_up(cameras)
    return upright_up(cameras) if up is None else up


def upright_up(cameras: Cameras) -> Float[Tensor, "3"]:
    """The up direction of upright photos: across the cameras' x axes, on the side of their mean up.

    Photos are hardly ever rolled but often look down, so that the x axes are more reliable.
    """
    rights, downs = cameras.viewmats[:, 0, :3].double(), cameras.viewmats[:, 1, :3].double()
    return _up_across(rights, -downs.mean(dim=0))


def side_up(cameras: Cameras) -> Float[Tensor, "3"] | None:
    """The up direction where photos lie on their side, as without EXIF orientation, else None.

    Nobody walks over the top of something and on beneath it: views that turn about their own x axes
    through more than `WALKED_OVER`, while the photos' upper edges point all ways, were taken around
    it. Up is across the y axes then; photos look down rather than up.
    """
    rights, downs, views = cameras.viewmats[:, :3, :3].double().unbind(dim=1)
    shares, axes = torch.linalg.eigh(rights.T @ rights / len(cameras))
    side = axes[:, -1]
    angles = torch.atan2(views @ axes[:, 0], views @ axes[:, 1]).sort().values
    gaps = torch.cat([angles, angles[:1] + 2 * torch.pi]).diff()
    is_upright = shares[-1] < MOSTLY_SIDEWAYS or downs.mean(dim=0).norm() > UPRIGHT
    if is_upright or gaps.max() > 2 * torch.pi - WALKED_OVER:
        return None
    return _up_across(downs, -side if (views @ side).mean() > 0 else side)


def _up_across(level: Float[Tensor, "C 3"], top: Float[Tensor, "3"]) -> Float[Tensor, "3"]:
    """The direction about perpendicular to axes that are level, on the side of `top`."""
    matrix = level.T @ level / len(level) + UP_RIDGE * torch.eye(3).double()
    return torch.nn.functional.normalize(torch.linalg.solve(matrix, top), dim=0)


def look_at(
    positions: Float[Tensor, "M 3"], focus: Float[Tensor, "3"], up: Float[Tensor, "3"]
) -> Float[Tensor, "M 4 4"]:
    """World-to-camera matrices (OpenCV axes) of cameras that look at a point."""
    forward = torch.nn.functional.normalize(focus - positions, dim=-1)
    right = torch.nn.functional.normalize(
        torch.linalg.cross(forward, up.expand_as(forward)), dim=-1
    )
    rotations = torch.stack([right, torch.linalg.cross(forward, right), forward], dim=1)
    viewmats = torch.eye(4).to(positions).repeat(len(positions), 1, 1)
    viewmats[:, :3, :3] = rotations
    viewmats[:, :3, 3] = -torch.einsum("mij,mj->mi", rotations, positions)
    return viewmats


def median_lens(cameras: Cameras) -> tuple[Float[Tensor, "3 3"], tuple[int, int]]:
    """Centred intrinsics and even size of the camera whose field of view is median in width."""
    widths = cameras.sizes[:, 0] / cameras.Ks[:, 0, 0].cpu()
    row = int(widths.argsort()[len(cameras) // 2])
    width, height = (size - size % 2 for size in cameras.sizes[row].tolist())
    K = cameras.Ks[row].clone()
    K[0, 2], K[1, 2] = width / 2, height / 2
    return K, (width, height)


def pixels(sizes: Tensor) -> str:
    """Rows of width and height as '540x960', or as the smallest 'to' the largest."""
    known = sorted({(w, h) for w, h in sizes.tolist()}, key=lambda size: size[0] * size[1])
    return " to ".join(f"{w}x{h}" for w, h in dict.fromkeys((*known[:1], *known[-1:])))
