"""The functional core in a trainer of your own: render, lift labels, pick, paint.

python examples/own_trainer.py MyCapture wave.jpg

`MyCapture` has camera poses and label maps in object_mask/. Nothing here knows a scene; all
functions take tensors, or nouns that hold tensors.
"""

import sys
from pathlib import Path

import torch

import stylesplat as ss
from stylesplat.functional import lift, paint, pick, rasterize
from stylesplat.stylization.config import StyleConfig

RATES = {"means": 2e-3, "scales": 1e-2, "quats": 1e-2, "opacities": 3e-2, "sh0": 2e-2}


def train(capture: ss.Capture, steps: int = 300) -> ss.Splats:
    """Fit one Gaussian for each sparse point: the shortest trainer that there is."""
    assert capture.points is not None
    count, loss = len(capture.points), torch.tensor(0.0)
    splats = ss.Splats(
        means=capture.points.clone(),
        quats=torch.tensor([1.0, 0, 0, 0]).repeat(count, 1),  # w, x, y, z
        scales=torch.full((count, 3), -2.5),  # logarithms
        opacities=torch.zeros(count),  # logits
        sh0=torch.zeros(count, 1, 3),
        shN=torch.zeros(count, 0, 3),
    )
    leaves = {name: splats.tensors()[name].requires_grad_() for name in RATES}
    groups = [{"params": [leaf], "lr": RATES[name]} for name, leaf in leaves.items()]
    adam = torch.optim.Adam(groups, eps=1e-15)
    for step in range(steps):
        row = step % len(capture)
        image, _, _ = rasterize(splats, capture.cameras[row])  # [1, H, W, 3]
        loss = (image[0] - capture.photos[row] / 255).abs().mean()
        adam.zero_grad()
        loss.backward()
        adam.step()
    print(f"{loss.item():.3f} off on average after {steps} steps")
    return splats.detach()


def main(
    folder: str, picture: str, steps: int = 300, config: StyleConfig | None = None
) -> ss.Splats:
    """Train, label, pick the first object and paint it; return the painted splats."""
    capture = ss.load(Path(folder))
    splats = lift(train(capture, steps), capture)  # labels, in closed form
    assert splats.classifier is not None
    mask = pick(splats, object_id=splats.classifier.ids[1])  # [N] bool
    painted = paint(splats, capture.cameras, mask, picture, config=config)
    print(f"{int(mask.sum()):,} of {len(splats):,} Gaussians are the object")
    return painted


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2])
