"""A step of the CPU rasteriser against one of the plain-torch reference, on the same scenes.

    .venv/bin/python benchmarks/against_reference.py

A step is a render with 3 or 19 channels and its gradients. The reference runs in float32, on all
cores, as torch does.
"""

from dataclasses import replace
from math import log

from bench import calibration_ms, capture, machine, median_ms, resized, step, table, trained_fox

from stylesplat.rendering.render import Backend
from stylesplat.scene.splats import Splats

SCENES = ((500, 8), (2000, 6), (5000, 4))  # Gaussians, downscale of 540 x 960


def sample(splats: Splats, count: int) -> Splats:
    """Some of the Gaussians, enlarged to cover what the others did."""
    fewer = resized(splats, count)
    return replace(fewer, scales=fewer.scales + log(len(splats) / count) / 3)


def main() -> None:
    """Print the table."""
    print(f"{machine()}, calibration loop {calibration_ms():.0f} ms")
    trained, full = trained_fox(), capture("fox").cameras[0]
    rows = []
    for count, downscale in SCENES:
        splats, camera = sample(trained, count), full.downscale(downscale)
        for identities in (False, True):

            def run(backend: Backend) -> None:
                step(splats, camera, identities=identities, backend=backend)  # noqa: B023

            reference = median_ms(lambda: run("reference"), repeats=3, warm_up=1)
            cpu = median_ms(lambda: run("cpu"), repeats=30)
            width, height = camera.size
            rows.append(
                [
                    f"{count:,}",
                    f"{width}x{height}",
                    19 if identities else 3,
                    f"{reference:.0f}",
                    f"{cpu:.2f}",
                    f"{reference / cpu:.0f}",
                ]
            )
    print(table(["Gaussians", "image", "channels", "reference ms", "CPU ms", "ratio"], rows))


if __name__ == "__main__":
    main()
