"""Painting an object from top to bottom, and the layer that comes of it."""

from collections.abc import Callable, Generator, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import chain
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Int
from scipy.ndimage import maximum_filter
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.imaging.color import Palette, build_palette
from stylesplat.io.style_pictures import Picture, read_style, resize
from stylesplat.progress import say, task
from stylesplat.rendering.view_pool import per_view
from stylesplat.rendering.visibility import VISIBLE_LARGE, in_view, visible
from stylesplat.rendering.weights import coverage, geometry_only
from stylesplat.runtime import tidy_heap
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.capture import Capture
from stylesplat.scene.layers import Composed, Layer, compose
from stylesplat.scene.splats import Splats
from stylesplat.selection.shares import OWN_SHARE, object_shares
from stylesplat.stylization.canvas import (
    Canvas,
    PaintState,
    build_surfels,
    drop_hidden,
    fit_surfels,
    layer_of,
)
from stylesplat.stylization.colors import (
    Colors,
    add_hue_noise,
    add_luminance,
    blur_colors,
    limit_hue_detail,
    low_pass_colors,
    object_colors,
    project_to_palette,
    transfer_colors,
    transfer_two_bands,
)
from stylesplat.stylization.config import DEFAULT_NETWORK, Stage, StyleConfig
from stylesplat.stylization.features import FeatureNetwork, load_weights
from stylesplat.stylization.form import FormSurvey, form_relief, survey_detail
from stylesplat.stylization.guides import Guides
from stylesplat.stylization.optimize import CANVAS_RATE, optimize_colors, stage_objective
from stylesplat.stylization.painting import (
    Painting,
    PaintSetup,
    check_paintings,
    paint_setup,
    with_relief_form,
)
from stylesplat.stylization.paper import paint_as_published
from stylesplat.stylization.style import (
    KEPT_HUES,
    STROKE_DEVIATION,
    STYLE_LARGEST,
    all_colors,
    large_shapes,
    style_parts,
    style_pictures,
)
from stylesplat.stylization.trim import close_gaps, reveal, split_large, trim_surfels
from stylesplat.stylization.views import (
    WHOLE_VIEWS,
    ObjectBox,
    ObjectView,
    find_boxes,
    object_views,
    reached_pixels,
    require_boxes,
    stage_views,
    typical_length,
    whole_views,
)

BLUR_VIEWS = 6  # of the whole object, that suffice between stages
SHARPENED = 2.0  # form of the finer band, added before fine stages: coarser ones lose it
PREVIEW_STEPS = 25  # on the object's own Gaussians: laying the canvas takes longer
REPORT_EVERY = 10  # steps between two updates of the loss in the progress bar


@dataclass(frozen=True, eq=False)
class Subject:
    """An object on the Gaussians that carry its paint."""

    setup: PaintSetup
    """Its scene is that of the canvas."""
    painting: Painting
    """Its mask has the Gaussians that are painted."""
    boxes: Sequence[ObjectBox]
    """Where the object is visible, in the views to optimise on."""
    detail: FormSurvey
    canvas: Canvas
    guides: Guides | None = None

    @property
    def stages(self) -> list[Stage]:
        return self.painting.config.stages(typical_length(self.boxes))

    @cached_property
    def rows(self) -> Int[Tensor, " P"]:
        """The Gaussians whose colours are optimised; on a GPU finding them waits for it."""
        return self.painting.mask.nonzero()[:, 0]

    def on(self, canvas: Canvas) -> "Subject":
        """The object on a canvas, whose colours are made the same from everywhere."""
        matte = canvas.splats.shN.masked_fill(canvas.mask[:, None, None], 0)
        canvas = canvas.changed(shN=matte)
        setup = replace(self.setup, splats=canvas.splats)
        painting = replace(self.painting, mask=canvas.mask)
        return replace(self, setup=setup, painting=painting, canvas=canvas)

    def painted(self, colors: Colors) -> Splats:
        """The scene with these colours of the object."""
        return self.canvas.splats.with_rows(self.rows, {"sh0": colors[:, None]})


class SurveyedObject(NamedTuple):
    """What of an object is the same whatever its style."""

    own: Bool[Tensor, " N"]
    """Its Gaussians, without those that lie mostly beside it."""
    boxes: list[ObjectBox]
    """Where the views show it."""
    detail: FormSurvey


class Goal(NamedTuple):
    """What the colours of an object are to become."""

    images: Sequence[Float[Tensor, "_ _ 3"]]
    """The style images, for strokes of this size."""
    palette: Palette | None
    """Their colours; None leaves the object's free."""
    relief: Float[Tensor, "P 2"]
    """The object's form, by bands; see `form_relief`."""


Finish = Callable[[Colors, Sequence[ObjectView]], Colors]  # completes a stage, given its views
WholeObject = tuple[Sequence[ObjectView], float]  # views of it, and its length there in pixels


def survey_object(setup: PaintSetup, painting: Painting) -> SurveyedObject:
    """Measure an object in its views. Raises a StyleSplatError if none shows it."""
    painting = own_part(setup, painting)
    boxes = require_boxes(setup, painting)
    return SurveyedObject(painting.mask, boxes, survey_detail(setup.splats, painting.mask, boxes))


def paint_steps(
    setup: PaintSetup,
    painting: Painting,
    *,
    preview: bool = False,
    survey: SurveyedObject | None = None,
) -> Iterator[PaintState]:
    """Paint one object of a scene; yields the state after every step.

    With `preview` first strokes show on the object's own Gaussians before the canvas is laid. These
    steps come in addition, and change nothing in the result. `survey` is that of `survey_object`,
    if it is known already.
    """
    painting = replace(painting, config=with_relief_form(painting.config))
    if painting.config.published:
        return paint_as_published(setup, painting)
    own, boxes, detail = survey or survey_object(setup, painting)
    painting = replace(painting, mask=own)
    canvas = Canvas.without_discs(setup.splats, painting.mask)
    guides = Guides.of(painting.config, setup.splats, painting.mask)
    subject = Subject(setup, painting, boxes, detail, canvas, guides)
    first, *_ = stages = subject.stages
    short = replace(first, steps=min(PREVIEW_STEPS, first.steps))
    previews = [short] if preview and painting.config.max_discs(1) > 0 else []
    steps = sum(stage.steps for stage in [*previews, *stages])
    states = chain(*(paint_preview(subject, stage) for stage in previews), paint_object(subject))
    return (replace(state, step=n, steps=steps) for n, state in enumerate(states, start=1))


def check_visible(setup: PaintSetup, painting: Painting) -> None:
    """Raise the errors of `paint_steps`, in less time than painting takes."""
    painting = own_part(setup, painting)
    boxes = require_boxes(setup, painting)
    length = typical_length(boxes)
    object_views(setup, painting, boxes, painting.config.stages(length)[0].length / length)


def own_part(setup: PaintSetup, painting: Painting) -> Painting:
    """The painting without Gaussians that lie mostly beside the object; the paper paints all."""
    if painting.config.published:
        return painting
    own = object_shares(setup.splats, painting.mask, setup.cameras) > OWN_SHARE
    if not own.any():
        require_boxes(setup, painting)  # else that is why
        raise StyleSplatError(
            f"Cannot stylise {painting.name}: most of what each of its Gaussians paints lies "
            "where they cover less than half. Pick more of the object."
        )
    return replace(painting, mask=own)


def paint_object(subject: Subject) -> Iterator[PaintState]:
    """Paint an object: coarse stages on new discs, then fine ones along their strokes."""
    config, stages = subject.painting.config, subject.stages
    generator = torch.Generator().manual_seed(config.seed)
    # the last stage of a draft, which has no fine ones, is its finest
    count = next((n for n, stage in enumerate(stages) if stage.fine), len(stages) - 1)
    coarse, (*fine, last) = stages[:count], stages[count:]

    subject = lay_discs(subject, last.length)
    colors, goal = initial_colors(subject, stages[0])
    for stage in coarse:
        finish = partial(melt_strokes, goal, subject, stage)
        colors = yield from paint_stage(subject, stage, colors, goal, generator, finish)

    subject, colors = align_and_trim(subject, colors, last.length)
    whole = views, length = whole_object(subject, stages[count], BLUR_VIEWS)
    relief = form_relief(subject.canvas.before, views, len(colors), length, subject.detail)
    colors = add_luminance(colors, SHARPENED * config.form * config.pattern_removed * relief[:, 0])
    goal = goal._replace(relief=relief)
    for stage in fine:
        finish = partial(match_style, goal, config, whole)
        colors = yield from paint_stage(subject, stage, colors, goal, generator, finish)
    finish = partial(settle_colors, goal, subject, last, whole)
    yield from paint_stage(subject, last, colors, goal, generator, finish)


def paint_preview(subject: Subject, stage: Stage) -> Iterator[PaintState]:
    """Paint first strokes on the object's own Gaussians."""
    subject = subject.on(subject.canvas)
    generator = torch.Generator().manual_seed(subject.painting.config.seed)
    colors, goal = initial_colors(subject, stage)
    finish = partial(melt_strokes, goal, subject, stage)
    yield from paint_stage(subject, stage, colors, goal, generator, finish)


def lay_discs(subject: Subject, length: float) -> Subject:
    """The object on a canvas that is fine enough for this length, if it has a surface for it."""
    painting, canvas = subject.painting, subject.canvas
    max_discs = painting.config.max_discs(int(painting.mask.sum()))
    if max_discs == 0 or painting.config.intensity == 0:
        return subject.on(canvas)
    laid = build_surfels(
        canvas.splats,
        canvas.mask,
        subject.boxes,
        length=length,
        max_discs=max_discs,
        seed=painting.config.seed,
    )
    if laid is None:
        say(f"{painting.name} has no surface for a canvas: its own Gaussians are painted.")
        return subject.on(canvas)
    return subject.on(drop_hidden(fit_surfels(laid, seed=painting.config.seed), length))


def initial_colors(subject: Subject, stage: Stage) -> tuple[Colors, Goal]:
    """The colours before the first stage, and what they are to become.

    They are the object's, without its pattern, with its form, and with the hues of the style.
    """
    painting, rows, config = subject.painting, subject.rows, subject.painting.config
    whole, length = whole_object(subject, stage, WHOLE_VIEWS)
    colors = subject.canvas.splats.sh0[rows, 0]
    relief = form_relief(subject.canvas.before, whole, len(rows), length, subject.detail)
    share = KEPT_HUES.get(config.color, 0.0)
    own = object_colors(colors, whole) if share > 0 else None
    images = style_pictures(painting.images, config, own, share)
    colors = low_pass_colors(
        colors, whole, length, config.pattern_removed, subject.detail.unevenness
    )
    form = config.form * config.pattern_removed  # what was removed of it with the pattern
    colors = add_luminance(colors, form * relief.sum(dim=1))
    if config.color == "free":
        return colors, Goal(images, None, relief)
    colors = add_hue_noise(colors, subject.canvas.splats.means[rows], seed=config.seed)
    colors = transfer_colors(colors, all_colors(large_shapes(images, config.scale)), whole)
    return colors, Goal(images, build_palette(all_colors(images)), relief)


def paint_stage(
    subject: Subject,
    stage: Stage,
    colors: Colors,
    goal: Goal,
    generator: torch.Generator,
    finish: Finish,
) -> Generator[PaintState, None, Colors]:
    """Take the steps of a stage, the last of which completes the colours; returns these."""
    setup, painting, canvas = subject.setup, subject.painting, subject.canvas
    views = stage_views(setup, painting, subject.boxes, stage, generator, canvas.surface)
    objective = stage_objective(
        setup,
        painting.config,
        goal.images,
        stage,
        subject.detail,
        goal.palette,
        rate=CANVAS_RATE if canvas.is_disc.any() else 1.0,
        guides=subject.guides,
    )
    targets = objective.targets(views, canvas.before, colors if stage.fine else None)
    relief = torch.zeros_like(canvas.splats.opacities)
    relief[subject.rows] = goal.relief.sum(dim=1)
    taken = optimize_colors(colors, targets, objective, stage.steps, seed=painting.config.seed)
    for step, (colors, nnfm) in enumerate(taken, start=1):
        if step == stage.steps and goal.palette is not None:
            colors = finish(colors, views)
        splats = subject.painted(colors)
        yield PaintState(step, stage.steps, nnfm, splats, canvas, relief, subject.boxes)
    return colors


def whole_object(
    subject: Subject, stage: Stage, least: int, views: Sequence[ObjectView] = ()
) -> WholeObject:
    """See `whole_views`."""
    return whole_views(subject.setup, subject.painting, subject.boxes, stage, least, views)


def melt_strokes(
    goal: Goal, subject: Subject, stage: Stage, colors: Colors, views: Sequence[ObjectView]
) -> Colors:
    """Leave the large shapes of a coarse stage, in the style's colours."""
    whole, _ = whole_object(subject, stage, BLUR_VIEWS, views)
    shapes = large_shapes(goal.images, subject.painting.config.scale)
    return transfer_colors(blur_colors(colors, whole), all_colors(shapes), whole)


def match_style(
    goal: Goal, config: StyleConfig, whole: WholeObject, colors: Colors, _: Sequence[ObjectView]
) -> Colors:
    """Give the object's large shapes the style's colours and tones, its detail the contrast."""
    views, length = whole
    longer = min(config.scale * length, STYLE_LARGEST)
    pictures = [resize(each, longer) for each in goal.images]
    deviations = STROKE_DEVIATION * length, STROKE_DEVIATION * longer / config.scale
    return transfer_two_bands(colors, pictures, views, *deviations)


def settle_colors(
    goal: Goal,
    subject: Subject,
    stage: Stage,
    whole: WholeObject,
    colors: Colors,
    views: Sequence[ObjectView],
) -> Colors:
    """Bring the colours of the last stage near to the palette, and their detail to the style's."""
    assert goal.palette is not None
    config, is_disc = subject.painting.config, subject.canvas.is_disc[subject.rows]
    colors = match_style(goal, config, whole, colors, views)
    pictures = [resize(*part) for part in style_parts(goal.images, config, stage.length)]
    colors = limit_hue_detail(colors, views, pictures, config.pattern_removed)
    return project_to_palette(colors, whole[0], goal.palette, ~is_disc & is_disc.any())


def align_and_trim(
    subject: Subject, colors: Colors, length: float
) -> tuple[Subject, Float[Tensor, "M 3"]]:
    """Turn the discs along the strokes, and let them show what the object shows.

    They are fine enough for views that show it so many pixels long.
    """
    if not subject.canvas.is_disc.any():
        return subject, colors
    canvas, kept = trim_surfels(
        subject.canvas,
        subject.setup.all_cameras,
        painted=subject.painted(colors),
        protected=subject.painting.protected,
        guides=subject.guides,
    )
    subject, colors = subject.on(canvas), colors[kept[subject.rows]]
    has_parts = subject.detail.unevenness > 0.5
    canvas, kept = reveal(subject.canvas, subject.boxes, length, has_parts=has_parts)
    colors = subject.canvas.splats.sh0[:, 0].index_copy(0, subject.rows, colors)[kept]
    canvas, sources = split_large(canvas, length, seed=subject.painting.config.seed)
    canvas = close_gaps(canvas, subject.boxes, length)
    subject = subject.on(replace(canvas, views=()))  # these take memory, and are not needed again
    return subject, colors[sources][subject.rows]


def paint(
    splats: Splats,
    capture: Capture | Cameras,
    mask: Bool[Tensor, " N"],
    style: Picture,
    *,
    config: StyleConfig | None = None,
    network: FeatureNetwork | None = None,
) -> Splats:
    """Repaint one object in the style of a picture (StyleSplat, section 3.4, and beyond).

    Of the object's Gaussians the colours change, and what a canvas hides of them fades; no other
    Gaussian changes. The canvas's new Gaussians follow all others.

    Args:
        splats: The scene.
        capture: Views of the object; their photos are not used.
        mask: The object's Gaussians.
        style: A picture's file, or its colours: floats in 0..1, or bytes.
        config: Settings; see `StyleConfig` and `STYLE_PRESETS`.
        network: The network whose features are matched; the package's own by default.

    Raises:
        StyleSplatError: If the picture is unfit, or the object is too small or not seen.
    """
    config = config or StyleConfig()
    cameras = capture.cameras if isinstance(capture, Capture) else capture
    network = network or load_weights(DEFAULT_NETWORK, depth=config.block)
    image = read_style(style, rotate=config.rotate, region=config.region)
    painting = Painting("object", mask, (image,), config)
    return paint_objects(paint_setup(splats, cameras, network), [painting]).splats


def paint_objects(setup: PaintSetup, paintings: Sequence[Painting]) -> Composed:
    """Repaint several objects one after the other, each on what is painted before."""
    check_paintings(paintings)
    painted = compose(setup.splats, ())
    for painting in paintings:
        own = painting.to(painted.splats).at(painted.parents)
        below = replace(setup, splats=painted.splats)
        layer, _ = paint_layer(below, own)
        painted = compose(painted.base, (*painted.layers, layer), painted)
    return painted


def paint_layer(setup: PaintSetup, painting: Painting) -> tuple[Layer, list[ObjectBox]]:
    """Paint an object on what lies below its layer.

    Returns the layer, and the boxes of the object in all views, held-out ones included.
    """
    part, own = crop_scene(setup, painting)
    state = None
    with task(painting.name, painting.config.all_steps) as bar:
        for state in paint_steps(part, own):
            bar.advance()
            if state.step % REPORT_EVERY == 0:
                bar.note(f"NNFM {state.nnfm:.3f}")
    assert state is not None  # there is at least one step
    layer = layer_of(state, own, setup.precision_name)
    boxes = [*state.boxes, *find_boxes(part.splats, part.held_out, own.mask)]
    tidy_heap()  # copies of the whole scene follow
    return layer, boxes


CROP_VISIBLE = 0.02  # share of some pixel: an object with less in a view is hidden, but for seams
CROP_MARGIN = 24  # pixels around what it may reach: in smaller renders Gaussians grow by as much


@torch.no_grad()
def crop_scene(setup: PaintSetup, painting: Painting) -> tuple[PaintSetup, Painting]:
    """Crop a large scene to the Gaussians and views that matter to an object.

    Besides the object's Gaussians these are all that would show near it if it were not there: what
    hides it, and what it hides. In views that hide the object some of these may be missing, so that
    they are left out. A small scene stays whole, and one of which no view shows the object.
    """
    splats, views = setup.splats, [*setup.all_cameras]
    names = {*setup.all_cameras.names}
    if len(splats) < VISIBLE_LARGE or len(names) < len(views):
        return setup, painting
    bare, own = geometry_only(splats), painting.mask.nonzero()[:, 0]
    others = replace(bare, opacities=bare.opacities.masked_fill(painting.mask, -torch.inf))
    alone = bare[own]

    def look(view: Cameras) -> Tensor | None:
        """The Gaussians that would show near the object; None if it is hidden."""
        near = reached_pixels(alone, view)
        if not near.any():
            return None
        near = torch.from_numpy(maximum_filter(near.cpu().numpy(), 2 * CROP_MARGIN + 1))
        rows = visible(in_view(others, view, near.to(own.device)), view).rows
        there = torch.cat([own, rows])
        is_own = torch.arange(len(there), device=there.device) < len(own)
        shares = coverage(bare[there], view, is_own)
        return rows if (shares > CROP_VISIBLE).any() else None

    kept, shown = painting.mask.clone(), set[str]()
    found = per_view(look, views, "looking around the object", splats.device)
    for view, rows in zip(views, found, strict=True):
        if rows is not None:
            kept[rows] = True
            shown.update(view.names)
    if shown.isdisjoint(setup.cameras.names):
        return setup, painting
    rows = kept.nonzero()[:, 0]
    cameras, all_cameras = (
        each[[n for n, name in enumerate(each.names) if name in shown]]
        for each in (setup.cameras, setup.all_cameras)
    )
    part = replace(setup, splats=splats[rows], cameras=cameras, all_cameras=all_cameras)
    return part, painting.at(rows)
