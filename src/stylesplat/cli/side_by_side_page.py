"""`stylesplat evaluate --compare`: several scenes on one page."""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from stylesplat.errors import StyleSplatError

if TYPE_CHECKING:
    from stylesplat.scene.capture import Capture
    from stylesplat.scene.scene import Scene
    from stylesplat.verbs.compare import Comparison

SUFFIX = ".html"
TOLD = (("psnr", "PSNR", 2), ("ssim", "SSIM", 3), ("miou", "IoU", 3))  # and how many digits
EXAMPLE = "`stylesplat evaluate A B --compare -o page.html`"


def refuse_wrong_mix(others: Sequence[Path], output: Path | None, *, compare: bool) -> Path | None:
    """The page to make; None if one scene is evaluated.

    Raises:
        StyleSplatError: If there are several scenes without --compare or one with it, or the
            output is no page.
    """
    if not compare:
        if others:
            raise StyleSplatError(
                f"Cannot evaluate {1 + len(others)} scenes at once. Compare them: {EXAMPLE}."
            )
        return None
    if not others:
        raise StyleSplatError(f"--compare needs at least two scenes, got one. Call {EXAMPLE}.")
    if output is None or output.suffix.lower() != SUFFIX:
        got = "none" if output is None else str(output)
        raise StyleSplatError(
            f"--compare makes an HTML page, got {got} as its place. Pass -o with a name in "
            f"{SUFFIX}."
        )
    return output


def write_comparison(
    paths: Sequence[Path],
    page: Path,
    capture_of: "Callable[[Scene, Path], Capture | None]",
    *,
    device: str,
) -> dict[str, Any]:
    """Compare scenes and write the page.

    Args:
        paths: Their folders.
        page: The HTML file to make.
        capture_of: Finds the photos of a scene; what it raises is said, and pictures and styles
            are compared all the same.
        device: Where to compute.

    Returns:
        The comparison's summary, and `page`.

    Raises:
        StyleSplatError: If a scene cannot be read, they share no view, or the page cannot be
            written.
    """
    from stylesplat.io.atomic import changing
    from stylesplat.io.scene_folder import open
    from stylesplat.progress import say
    from stylesplat.scene.scene import shared_views
    from stylesplat.verbs.compare import compare

    names = _names(paths)
    scenes = {name: open(path) for name, path in zip(names, paths, strict=True)}
    shared_views(scenes)  # before photos are read
    captures = {}
    for name, path in zip(names, paths, strict=True):
        try:
            found = capture_of(scenes[name], path)
        except StyleSplatError as error:
            say(str(error))
            found = None
        if found is not None:
            captures[name] = found
    with changing(page):
        comparison = compare(scenes, captures, device=device)
        _write(comparison, page)
    return {**comparison.summary(), "page": page}


def comparison_lines(result: dict[str, Any]) -> Iterator[str]:
    """The most telling numbers, a scene a line, and where the page is."""
    for scene in result["scenes"]:
        metrics, differences = scene["metrics"], scene["differences"]
        parts = [
            f"{label} {metrics[name]:.{digits}f} ({differences.get(name, 0):+.{digits}f})"
            for name, label, digits in (
                ("psnr", "PSNR", 2),
                ("ssim", "SSIM", 3),
                ("miou", "IoU", 3),
            )
            if name in metrics
        ]
        changed = 100 * scene["from_first"]["changed_share"]
        yield f"{scene['name']}: {', '.join([*parts, f'{changed:.1f} % of its pixels differ'])}."
    yield f"Page: {result['page']}, with all numbers and {len(result['views'])} views of each."


def _write(comparison: "Comparison", page: Path) -> None:
    from stylesplat.figures.html_page import comparison_page
    from stylesplat.io.atomic import atomic_path

    text = comparison_page(
        comparison.scenes, comparison.views, title="Scenes compared", notes=comparison.notes
    )
    with atomic_path(page) as temporary:
        temporary.write_text(text, encoding="utf-8")


def _names(paths: Sequence[Path]) -> list[str]:
    """The folders' own names, or where two share one all of the path, numbered if need be."""
    short = [path.resolve().name for path in paths]
    names = short if len(set(short)) == len(short) else [str(path) for path in paths]
    return [
        name if name not in names[:row] else f"{name} ({row + 1})" for row, name in enumerate(names)
    ]
