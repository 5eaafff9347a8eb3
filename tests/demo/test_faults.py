import numpy as np
import pytest
import torch

from stylesplat.demo.faults import FaultConfig, corrupt_label_maps

NONE = {"border": 0.0, "missing": 0.0, "merged": 0.0, "fragments": 0.0}


def discs() -> torch.Tensor:
    """Two touching discs and one apart, with ids 1, 7 and 300."""
    y, x = np.indices((90, 120))
    labels = np.zeros((90, 120), np.int64)
    for i, cx, cy in ((1, 30, 30), (7, 66, 30), (300, 85, 70)):
        labels[np.hypot(x - cx, y - cy) < 18] = i
    return torch.from_numpy(labels)


def test_the_same_seed_gives_the_same_faults_and_another_does_not():
    maps = [discs()] * 6
    one, again, other = (corrupt_label_maps(maps, seed=s) for s in (1, 1, 2))
    assert all(torch.equal(a, b) for a, b in zip(one, again, strict=True))
    assert not all(torch.equal(a, b) for a, b in zip(one, other, strict=True))


def test_no_faults_change_nothing():
    assert torch.equal(corrupt_label_maps([discs()], config=FaultConfig(**NONE))[0], discs())


def test_borders_move_but_the_inside_stays():
    exact = discs()
    config = FaultConfig(**{**NONE, "border": 16.0})  # 4 pixels at this width
    (frayed,) = corrupt_label_maps([exact], config=config)
    wrong = (frayed != exact).float().mean()
    assert 0.01 < wrong < 0.10
    y, x = np.indices((90, 120))
    core = torch.from_numpy(np.hypot(x - 30, y - 30) < 18 - 5)
    assert (frayed[core] == 1).all()


@pytest.mark.parametrize(
    ("fault", "happened"),
    [
        ("missing", lambda ids: ids == {0}),
        ("merged", lambda ids: ids in ({0, 1, 300}, {0, 7, 300})),
    ],
)
def test_ids_go_missing_and_neighbours_merge(fault: str, happened):
    (faulty,) = corrupt_label_maps([discs()], config=FaultConfig(**{**NONE, fault: 1.0}))
    assert happened(set(faulty.unique().tolist()))


def test_fragments_carry_the_id_of_another_object():
    exact = discs()
    (faulty,) = corrupt_label_maps([exact], config=FaultConfig(**{**NONE, "fragments": 1.0}))
    changed = faulty != exact
    assert changed.any()
    assert (exact[changed] > 0).all() and (faulty[changed] > 0).all()


def test_the_demo_faults_keep_most_pixels_and_invent_no_ids():
    maps = [discs()] * 40
    faulty = corrupt_label_maps(maps, seed=3)
    kept = [(a == b).float().mean().item() for a, b in zip(maps, faulty, strict=True)]
    assert 0.9 < np.mean(kept) < 0.99
    assert set(torch.cat(faulty).unique().tolist()) <= {0, 1, 7, 300}
    lost = [i for m in faulty for i in (1, 7, 300) if not (m == i).any()]
    assert 0 < len(lost) < 40


def test_shadows_count_as_parts_of_objects_on_the_background_alone():
    exact = discs()
    shadow = torch.zeros_like(exact)
    shadow[20:40] = 1  # across the disc that casts it, and across another
    config = FaultConfig(**NONE, shadows=1.0)
    (faulty,) = corrupt_label_maps([exact], shadows=[shadow], config=config)
    assert torch.equal(faulty, torch.where(exact == 0, shadow, exact))
    (unshaded,) = corrupt_label_maps([exact], shadows=[shadow], config=FaultConfig(**NONE))
    assert torch.equal(unshaded, exact)
