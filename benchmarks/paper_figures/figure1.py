"""Figures 1 and 4: one object in three styles."""

from functools import partial
from time import process_time

from paper_figures.book import Cell, Outcome, Results
from paper_figures.figure2 import leakage
from paper_figures.painting import default_config, painted, paper_config
from paper_figures.story import Block, Figure, Row, Table, digits, percent
from paper_figures.subject import Subject, cut, shot
from stylesplat.evaluation.style import content_ssim, measure_style
from stylesplat.stylization.painter import paint_setup
from stylesplat.stylization.painting import Painting

NAME = "figure1"
WAYS = {"paper": paper_config, "ours": default_config}
CLAIM = (
    "style transfer is confined to the selected object and keeps its shape and shadows; it takes "
    "less than a minute on an A100."
)


def cells(subject: Subject) -> list[Cell]:
    """Each style, as the paper does it and as we do."""
    found = [Cell(NAME, "initial", partial(_initial, subject))]
    for style in subject.styles:
        found += [
            Cell(NAME, f"{style}, {way}", partial(_styled, subject, style, way)) for way in WAYS
        ]
    return found


def _initial(subject: Subject) -> Outcome:
    id = subject.ids[0]
    camera = subject.best_view(id)
    mask = subject.true_map(camera) == id
    pictures = {"object": cut(shot(subject.splats, camera), mask)}
    return Outcome({"object": subject.called(id)}, pictures | dict(subject.styles))


def _styled(subject: Subject, style: str, way: str) -> Outcome:
    id, picture, config = subject.ids[0], subject.styles[style], WAYS[way](subject)
    picked = subject.picked(id)
    start = process_time()
    styled = painted(subject, {id: picture}, config).splats
    spent = process_time() - start
    numbers = {"painting": spent} | leakage(subject, subject.splats, styled, id)
    numbers["content_ssim"] = content_ssim(subject.splats, styled, subject.held_out, picked)
    job = Painting(subject.called(id), picked, (picture,), config)
    studio = paint_setup(subject.splats, subject.held_out, subject.network)
    close = measure_style(studio, job, styled)
    numbers |= {name: close[name] for name in ("nnfm_before", "nnfm_after")}
    camera = subject.best_view(id)
    mask = subject.true_map(camera) == id
    return Outcome(numbers, {"object": cut(shot(styled, camera), mask)})


def told(results: Results) -> list[Block]:
    """A row of pictures for each way, and the table."""
    found = results.get(NAME, {})
    keys = [key for key in found if key != "initial"]
    if not keys:
        return []
    blocks: list[Block] = []
    first = found["initial"].pictures if "initial" in found else {}
    blocks += [Row({k: v for k, v in first.items() if k != "object"})] if first else []
    for way in WAYS:
        shown = {"initial": first["object"]} if first else {}
        shown |= {key: found[key].pictures["object"] for key in keys if key.endswith(way)}
        blocks.append(Row(shown))
    heads = ("style", "NNFM before", "after", "content SSIM", "strength (Lab)")
    heads += ("outside PSNR", "more than 2 px outside", "processor seconds")
    rows = [
        [
            key,
            *(digits(found[key].numbers[n]) for n in ("nnfm_before", "nnfm_after", "content_ssim")),
            digits(found[key].numbers["strength"], 1),
            f"{digits(found[key].numbers['outside_psnr'], 1)} dB",
            percent(found[key].numbers["changed_far"]),
            f"{found[key].numbers['painting']:.0f}",
        ]
        for key in keys
    ]
    return [*blocks, Table(heads, rows)]


FIGURE = Figure(NAME, "Figures 1 and 4: three styles", CLAIM, cells, told)
