"""Figure 5: two objects in two styles, each alone and the layers of both together."""

from functools import partial

import torch
from torch import Tensor

from paper_figures.book import Cell, Outcome, Results
from paper_figures.painting import default_config, painted, paper_config
from paper_figures.story import Block, Figure, Row, Table, Text
from paper_figures.subject import Subject, shot
from stylesplat.scene.layers import Composed, compose

NAME = "figure5"
CLAIM = "each of two objects takes its own style, alone or together; nothing else changes."
WAYS = {"paper": paper_config, "ours": default_config}


def cells(subject: Subject) -> list[Cell]:
    """Both ways of painting; a scene of one object has no such figure."""
    if len(subject.ids) < 2:
        return []
    return [Cell(NAME, way, partial(_both, subject, way)) for way in WAYS]


def _both(subject: Subject, way: str) -> Outcome:
    one, other = subject.ids[:2]
    pictures = [*subject.styles.values()][:2]
    styles, config = dict(zip((one, other), pictures, strict=True)), WAYS[way](subject)
    alone = {id: painted(subject, {id: style}, config) for id, style in styles.items()}
    together = compose(subject.splats, tuple(each for a in alone.values() for each in a.layers))
    picked = {id: subject.picked(id) for id in styles}
    numbers = {
        "objects": [subject.called(id) for id in styles],
        "gaussians": {subject.called(id): int(mask.sum()) for id, mask in picked.items()},
        "shared": int((picked[one] & picked[other]).sum()),
        "rows": len(together.splats),
        "expected_rows": sum(len(a.splats) for a in alone.values()) - len(subject.splats),
    }
    differing = {subject.called(id): _differing(alone[id], together, id, picked) for id in styles}
    numbers |= {"differing": differing, "changed_elsewhere": _elsewhere(subject, together, picked)}
    camera = subject.best_view(one, other)
    shown = {"initial": shot(subject.splats, camera)}
    shown |= {f"{subject.called(id)} alone": shot(a.splats, camera) for id, a in alone.items()}
    return Outcome(numbers, shown | {"both": shot(together.splats, camera)})


def _differing(alone: Composed, together: Composed, id: int, picked: dict[int, Tensor]) -> int:
    """Gaussians of an object, children included, that are not the same to the bit."""
    owns = [picked[id][styled.parents] for styled in (alone, together)]
    sizes = [int(own.sum()) for own in owns]
    if sizes[0] != sizes[1]:
        return max(sizes)
    rows = torch.zeros(sizes[0], dtype=torch.bool)
    for name, tensor in alone.splats.tensors().items():
        pair = tensor[owns[0]], together.splats.tensors()[name][owns[1]]
        rows |= (pair[0] != pair[1]).reshape(sizes[0], -1).any(dim=1)
    return int(rows.sum())


def _elsewhere(subject: Subject, together: Composed, picked: dict[int, Tensor]) -> int:
    """Gaussians of nothing that was painted that changed in any number."""
    others = ~torch.stack([*picked.values()]).any(dim=0)
    rows = torch.zeros(int(others.sum()), dtype=torch.bool)
    for name, tensor in subject.splats.tensors().items():
        after = together.splats.tensors()[name][: len(others)]
        rows |= (tensor[others] != after[others]).reshape(len(rows), -1).any(dim=1)
    return int(rows.sum())


def told(results: Results) -> list[Block]:
    """Pictures, and whether together is the two alone."""
    found = results.get(NAME, {})
    if not found:
        return []
    blocks: list[Block] = [Row(result.pictures) for result in found.values()]
    heads = (
        "",
        "Gaussians of the objects",
        "differ from alone",
        "rows",
        "expected",
        "others changed",
    )
    rows, equal = [], True
    for way, result in found.items():
        n = result.numbers
        differing = ", ".join(f"{name} {count}" for name, count in n["differing"].items())
        counts = ", ".join(f"{name} {count:,}" for name, count in n["gaussians"].items())
        row = [way, counts, differing, f"{n['rows']:,}", f"{n['expected_rows']:,}"]
        rows.append([*row, str(n["changed_elsewhere"])])
        equal &= n["rows"] == n["expected_rows"] and not any(n["differing"].values())
        equal &= n["changed_elsewhere"] == 0
    line = "Painted together, the two objects equal those painted alone, to the bit."
    line = line if equal else "Painted together, the two objects differ from those painted alone."
    return [*blocks, Table(heads, rows), Text(line)]


FIGURE = Figure(NAME, "Figure 5: two objects", CLAIM, cells, told)
