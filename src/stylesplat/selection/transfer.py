"""`import --like`: the objects and layers of a scene for a splat that was edited elsewhere."""

from dataclasses import replace

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.io.splats.splat_ply import MAX_DEGREE, of_degree
from stylesplat.photo_libraries import cv2
from stylesplat.progress import say
from stylesplat.scene.capture import BACKGROUND
from stylesplat.scene.frames import FRAME_SAME, Frame, in_frame_of, move_cameras, move_splats
from stylesplat.scene.layers import Layer, layer_subset
from stylesplat.scene.objects import SceneObject
from stylesplat.scene.scene import Scene
from stylesplat.scene.splats import Splats

# Largest differences between two Gaussians that may be the same; rounding of formats is smaller
TRANSFER_NEAR = 0.002  # of the splat's extent, for positions
TRANSFER_SIZES = 0.35  # for logarithms of standard deviations
TRANSFER_OPACITIES = 0.06  # for opacities, 0 to 1
TRANSFER_NEIGHBOURS = 8  # compared with each Gaussian: 3DGS-MCMC leaves copies in one place
UNMOVED = 0.9  # share of Gaussians in their old place, above which no motion is estimated
TRANSFER_LEAST = 16  # matches that are not chance
TRANSFER_SAMPLE = 4000  # Gaussians that a motion is estimated from
UNIQUE = 0.6  # ratio of distances to the nearest and second nearest descriptor (Lowe's test)
EDITED = 0.1  # median change of the constant band, above which colours were edited

Numbers = Float[np.ndarray, "_ D"]


def transfer_annotations(splats: Splats, scene: Scene, *, name: str = "The splat") -> Scene:
    """The scene with a splat that another program made of its own.

    Gaussians are matched by position, scale and opacity, in any order and after one rigid motion
    with scale. They keep their objects and, unless their colours were edited, their layers of
    paint. New Gaussians belong to no object. `name` is the splat's, for messages.

    Its metrics are `gaussians`, `matched`, `new_gaussians`, `lost_gaussians` and `moved`: empty, or
    the number of `gaussians`, the `scale` and the `degrees` of the motion.
    """
    splats = in_frame_of(of_degree(splats.to("cpu"), MAX_DEGREE), scene.world_offset)
    frame, rows = match_gaussians(splats, scene.splats)
    here = rows >= 0
    if int(here.sum()) < min(TRANSFER_LEAST, len(splats)):
        raise StyleSplatError(
            f"{name} shows nothing of {scene.path or 'the scene'}: none of its {len(splats):,} "
            "Gaussians is one of these. Name the scene that it came from, or import it without one."
        )
    found = replace(
        scene,
        base=_with_identities(splats, scene.splats, rows.clamp(min=0), here),
        layers=(),
        cameras=scene.cameras if frame is FRAME_SAME else move_cameras(scene.cameras, frame),
        objects=_objects(scene, rows.clamp(min=0), here),
        path=None,
    )
    if scene.layers and not _is_edited(scene, splats, rows):
        found = _with_layers(scene, found, frame, rows)
    matched = int(here.sum())
    degrees = float(np.degrees(Rotation.from_matrix(frame.rotation.numpy()).magnitude()))
    motion = {"gaussians": matched, "scale": round(frame.scale, 6), "degrees": round(degrees, 3)}
    metrics = {
        "gaussians": len(splats),
        "matched": matched,
        "new_gaussians": len(splats) - matched,
        "lost_gaussians": len(scene.splats) - matched,
        "moved": [] if frame is FRAME_SAME else [motion],
    }
    return replace(found, metrics=metrics)


def match_gaussians(found: Splats, known: Splats) -> tuple[Frame, Int[Tensor, " M"]]:
    """The motion from known to found Gaussians, and the known row of each found one, -1 if new."""
    rows = _nearest(found, known, FRAME_SAME)
    if (rows >= 0).mean() < UNMOVED and (frame := _motion(found, known)) is not None:
        moved_rows = _nearest(found, known, frame)
        if (moved_rows >= 0).sum() > (rows >= 0).sum():
            return frame, torch.from_numpy(moved_rows)
    return FRAME_SAME, torch.from_numpy(rows)


def _nearest(found: Splats, known: Splats, frame: Frame) -> Int[np.ndarray, " M"]:
    """The known row of each Gaussian, one to one, assigned in order of distance."""
    means = found.means.numpy()
    reach = TRANSFER_NEAR * max(
        np.ptp(np.quantile(means, (0.02, 0.98), axis=0), axis=0).max(), 1e-9
    )
    mine, theirs = _features(found, FRAME_SAME, reach), _features(known, frame, reach)
    rows, free = np.full(len(found), -1), np.arange(len(known))
    asking = np.arange(len(found))
    while len(asking) and len(free):
        count = min(TRANSFER_NEIGHBOURS, len(free))
        tree = KDTree(theirs[free])
        found_pairs = tree.query(mine[asking], k=count, p=np.inf, distance_upper_bound=1)
        away, near = (np.asarray(each).reshape(-1, count) for each in found_pairs)
        order = np.argsort(away, axis=None, kind="stable")[: np.isfinite(away).sum()]
        taken_now = set[int]()
        for i, j in zip(asking[order // count].tolist(), near.ravel()[order].tolist(), strict=True):
            if rows[i] < 0 and j not in taken_now:
                rows[i] = free[j]
                taken_now.add(j)
        asking = asking[np.isfinite(away[:, 0]) & (rows[asking] < 0)]  # of more copies
        free = np.delete(free, [*taken_now])
    return rows


def _features(splats: Splats, frame: Frame, reach: float) -> Numbers:
    """Positions, scales and opacities in units of the tolerated differences."""
    means = frame.place(splats.means.double()) / reach
    sizes = (splats.scales.double().sort(dim=1).values + np.log(frame.scale)) / TRANSFER_SIZES
    opacities = torch.sigmoid(splats.opacities.double())[:, None] / TRANSFER_OPACITIES
    return torch.cat([means, sizes, opacities], dim=1).numpy()


def _motion(found: Splats, known: Splats) -> Frame | None:
    """The similarity between Gaussians of equal descriptors, by RANSAC."""
    sample = np.random.default_rng(0).permutation(len(found))[:TRANSFER_SAMPLE]
    extent = float(np.ptp(found.means.numpy(), axis=0).max())
    if min(len(sample), len(known)) < TRANSFER_LEAST:
        return None
    for colors in (True, False):
        mine, theirs = _descriptors(found, colors)[sample], _descriptors(known, colors)
        spread = theirs.std(axis=0) + 1e-9
        away, near = map(np.asarray, KDTree(theirs / spread).query(mine / spread, k=2))
        clear = away[:, 0] < UNIQUE * away[:, 1]
        before = known.means.double().numpy()[near[clear, 0]]
        after = found.means.double().numpy()[sample[clear]]
        if len(before) < TRANSFER_LEAST:
            continue
        fits = cv2.estimateAffine3D(before, after, ransacThreshold=TRANSFER_NEAR * extent)[2]
        inliers = fits.ravel().astype(bool)
        if inliers.sum() >= max(TRANSFER_LEAST, len(sample) // 50):
            matrix, scale = cv2.estimateAffine3D(
                before[inliers], after[inliers], force_rotation=True
            )
            rotation, shift = torch.from_numpy(matrix).split([3, 1], dim=1)
            return Frame(rotation.contiguous(), float(scale), shift[:, 0].contiguous())
    return None


def _descriptors(splats: Splats, colors: bool) -> Numbers:
    """Quantities that no motion changes: opacities, ratios of scales, and maybe colours."""
    parts = [torch.sigmoid(splats.opacities)[:, None], splats.scales.sort(dim=1).values.diff(dim=1)]
    return torch.cat([*parts, splats.sh0[:, 0]] if colors else parts, dim=1).numpy()


def _with_identities(
    splats: Splats, known: Splats, rows: Int[Tensor, " M"], here: Bool[Tensor, " M"]
) -> Splats:
    """The splats with known identities; new Gaussians get the most probable background's."""
    if known.identities is None or known.classifier is None:
        return splats
    nobody = known.identities.new_zeros(known.identities.shape[1])
    if BACKGROUND in known.classifier.ids:
        column = known.classifier.ids.index(BACKGROUND)
        scores = known.classifier.some_at_a_time(known.identities)
        shares = torch.cat([each.softmax(dim=-1)[:, column] for _, each in scores])
        nobody = known.identities[shares.argmax()]
    confidence = known.confidence
    return replace(
        splats,
        identities=torch.where(here[:, None], known.identities[rows], nobody),
        classifier=known.classifier,
        confidence=None if confidence is None else torch.where(here, confidence[rows], 0.0),
    )


def _objects(
    scene: Scene, rows: Int[Tensor, " M"], here: Bool[Tensor, " M"]
) -> dict[str, SceneObject]:
    """The objects that still have Gaussians; reports lost ones."""
    objects = dict[str, SceneObject]()
    for name, each in scene.objects.items():
        before = scene.to_splats(each.mask)
        mask = before[rows] & here
        count, before = int(mask.sum()), int(before.sum())
        if count < before:
            left = f"{count:,} of its {before:,} Gaussians are" if count else "nothing is"
            say(f"{name}: {left} left.")
        if count:
            objects[name] = replace(each, mask=mask)
    return objects


def _is_edited(scene: Scene, splats: Splats, rows: Int[Tensor, " M"]) -> bool:
    """Whether colours of painted Gaussians were edited; reports that."""
    painted = torch.stack([layer.covered(len(scene.base)) for layer in scene.layers]).any(dim=0)
    mine = (rows >= 0) & scene.to_splats(painted)[rows.clamp(min=0)]
    if not mine.any():
        return True
    change = (splats.sh0[mine] - scene.splats.sh0[rows[mine]]).abs().median()
    if change > EDITED:
        say("The painted colours were edited: the layers of paint become part of the splat.")
    return bool(change > EDITED)


def _with_layers(scene: Scene, found: Scene, frame: Frame, rows: Int[Tensor, " M"]) -> Scene:
    """The scene with the known layers on the remaining rows; surfels come last."""
    known = scene.base
    mine = (rows < len(known)).nonzero()[:, 0]  # new ones too, whose row is -1
    base_rows = rows[mine]
    places = torch.full((len(known),), -1)
    places[base_rows[base_rows >= 0]] = (base_rows >= 0).nonzero()[:, 0]
    covered = torch.zeros(len(known), dtype=torch.bool)
    layers, order, end = list[Layer](), [mine], len(known)
    for layer in scene.layers:
        covered[layer.rows] = True
        paint = of_degree(replace(known[layer.rows], sh0=layer.sh0, shN=layer.shN), MAX_DEGREE)
        surfels = move_splats(of_degree(layer.surfels, MAX_DEGREE), frame)
        layer = replace(layer, shN=move_splats(paint, frame).shN, surfels=surfels)
        part = layer_subset(layer, places)
        if layer.is_shown:
            first, end = end, end + len(layer.parents)
            new = ((rows >= first) & (rows < end)).nonzero()[:, 0]
            order.append(new)
            shapes = {n: getattr(found.base, n)[new] for n in ("means", "quats", "scales")}
            part = layer_subset(layer, places, rows[new] - first)
            part = replace(part, surfels=replace(part.surfels, **shapes))
        if len(part.rows) or len(part.parents):
            layers.append(part)
    if not layers:
        return found
    hidden = (covered[base_rows.clamp(min=0)] & (base_rows >= 0)).nonzero()[:, 0]
    before = of_degree(move_splats(known[base_rows[hidden]], frame), MAX_DEGREE)
    looks = {n: getattr(before, n) for n in ("sh0", "shN", "opacities")}
    base = found.base[mine].with_rows(hidden, looks)
    painted = replace(found, base=base, layers=tuple(layers))
    objects = {
        name: replace(each, mask=painted.most_of(each.mask[torch.cat(order)]))
        for name, each in found.objects.items()
    }
    return replace(painted, objects=objects)
