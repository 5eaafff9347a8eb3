import pytest
import torch

from balls import SPLATS
from stylesplat.rendering.rasterize import rasterize
from stylesplat.scene.poses import up_vector
from stylesplat.scene.ring import ring_cameras


@pytest.mark.parametrize("up", [[0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
def test_the_content_is_in_the_middle_and_whole(up: list[float]):
    cameras = ring_cameras(SPLATS, torch.tensor(up))
    assert len(set(cameras.names)) == len(cameras) > 20
    torch.testing.assert_close(up_vector(cameras).float(), torch.tensor(up), atol=0.01, rtol=0)
    for row in range(0, len(cameras), 9):
        _, alphas, _ = rasterize(SPLATS, cameras[row].downscale(8))
        rows, columns = (alphas[0, ..., 0] > 0.5).nonzero().float().mean(dim=0).tolist()
        assert 30 < rows < 60  # of 90
        assert 45 < columns < 75  # of 120


def test_a_single_gaussian_is_looked_at():
    one = SPLATS[torch.tensor([0])]
    cameras = ring_cameras(one, torch.tensor([0.0, 0.0, 1.0]))
    assert cameras.viewmats.isfinite().all()
    assert (torch.linalg.det(cameras.viewmats[:, :3, :3]) - 1).abs().max() < 1e-4


def test_far_away_gaussians_do_not_matter():
    with_strays = SPLATS.means.clone()
    with_strays[:5] *= 1000
    from dataclasses import replace

    near = ring_cameras(SPLATS, torch.tensor([0.0, 0.0, 1.0])).positions
    far = ring_cameras(replace(SPLATS, means=with_strays), torch.tensor([0.0, 0.0, 1.0])).positions
    assert (near - far).norm(dim=1).max() < 0.2 * near.norm(dim=1).max()
