import torch

from stylesplat.demo.shadows import contact_shadows
from stylesplat.demo.still_life import dome_cameras, photograph


def test_shadows_lie_dark_on_the_table_beside_their_objects():
    cameras = dome_cameras(8, 96, 72)
    views = list(photograph(cameras, 0))
    shadows = contact_shadows(cameras, views, 0)
    shaded, lit = [], []
    for view, shadow in zip(views, shadows, strict=True):
        assert (view.labels[shadow > 0] == 0).all()
        for id in shadow.unique().tolist():
            assert id == 0 or (view.labels == id).any()
        brightness = view.photo.float().mean(dim=-1)
        beside = torch.nn.functional.max_pool2d((shadow > 0).float()[None], 15, 1, 7)[0] > 0
        shaded.append(brightness[shadow > 0])
        lit.append(brightness[beside & (shadow == 0) & (view.labels == 0)])
    assert len(torch.cat(shaded)) > 200
    assert torch.cat(shaded).mean() < 0.75 * torch.cat(lit).mean()
