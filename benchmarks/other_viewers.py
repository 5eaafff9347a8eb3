"""Do other people's viewers show our exports as we render them?

    npm install --prefix NPM @sparkjsdev/spark three @playcanvas/supersplat-viewer
    .venv/bin/python benchmarks/other_viewers.py SCENE NPM

Spark (on three.js) and SuperSplat's viewer (on PlayCanvas's engine) in headless Chromium with
software WebGL show every format that they read, from level cameras where photos were taken.
Screenshots are compared with our own renders of what the file holds; target: 28 dB. Pictures of
both and ten times their difference are kept in `benchmarks/out/viewers`. Needs Chromium and npm
packages, a minute a file.
"""

import json
import math
import shutil
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

import numpy as np
import torch
import tyro
from bench import table
from PIL import Image
from tyro.conf import Positional

import stylesplat as ss
from chromium import Page, launched
from stylesplat.figures.pictures import to_uint8
from stylesplat.io.splats.splat_files import read_splats
from stylesplat.metrics.psnr import psnr
from stylesplat.rendering.render import rasterize
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.framing import centred_K
from stylesplat.scene.poses import look_at, median_lens
from stylesplat.scene.scene import Scene

SIZE = 400, 400  # square: one program takes fields of view across, the other down
OUT = Path(__file__).parent / "out" / "viewers"
SPARK = (".ply", ".compressed.ply", ".splat", ".sog")  # 2.2 reads SPZ up to version 3, ours is 4
SUPERSPLAT = (".ply", ".compressed.ply", ".sog")
PATIENCE, STILL = 90.0, 3  # seconds for a picture; screenshots as the one before that make it one
ALIKE = 0.1  # of 255: sorting anew moves some pixels for ever
SPARK_PAGE = """
<style>body { margin: 0; background: black }</style>
<script type="importmap">{"imports": {
  "three": "./node_modules/three/build/three.module.js",
  "three/addons/": "./node_modules/three/examples/jsm/",
  "@sparkjsdev/spark": "./node_modules/@sparkjsdev/spark/dist/spark.module.js"}}</script>
<script type="module">
  import * as THREE from "three";
  import { SparkRenderer, SplatMesh } from "@sparkjsdev/spark";
  const { width, height, fov, position, target, up, file } = %s;
  const renderer = new THREE.WebGLRenderer({ antialias: false });
  renderer.setSize(width, height);
  document.body.append(renderer.domElement);
  const scene = new THREE.Scene();
  // As for all splats that were trained without anti-aliasing
  const blur = { preBlurAmount: 0.3, blurAmount: 0 };
  scene.add(new SparkRenderer({ renderer, sortRadial: false, ...blur }));
  const camera = new THREE.PerspectiveCamera(fov, width / height, 0.01, 1000);
  camera.up.set(...up);
  camera.position.set(...position);
  camera.lookAt(...target);
  const mesh = new SplatMesh({ url: file });
  scene.add(mesh);
  await mesh.initialized;
  const draw = () => {
    renderer.render(scene, camera);
    const gl = renderer.getContext();
    gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));  // waits for it
    setTimeout(draw, 500);
  };
  draw();
</script>
"""


@dataclass(frozen=True)
class Options:
    """What to show."""

    scene: Positional[Path]
    """Folder of a scene."""
    npm: Positional[Path]
    """Where the packages are."""
    views: tuple[str, ...] = ()
    """Photos to look from; by default three, evenly spread."""
    formats: tuple[str, ...] = SPARK
    """Endings of files."""


@dataclass(frozen=True)
class Sight:
    """A level camera, as all programs can be told of one."""

    name: str
    position: tuple[float, ...]
    target: tuple[float, ...]
    fov: float
    """Of the height, in degrees."""

    def camera(self) -> Cameras:
        """As we have it: down is y."""
        eye = torch.tensor([self.position]).double()
        up = torch.tensor([0.0, -1.0, 0.0]).double()
        viewmat = look_at(eye, torch.tensor(self.target).double(), up)
        focal = SIZE[1] / 2 / math.tan(math.radians(self.fov) / 2)
        K = centred_K(focal, SIZE)[None]
        return Cameras(viewmat.float(), K, torch.tensor([SIZE]), (self.name,))


def sights(scene: Scene, names: tuple[str, ...]) -> list[Sight]:
    """Where photos were taken, without their roll."""
    cameras = scene.cameras
    rows = [cameras.index(name) for name in names]
    rows = rows or [len(cameras) * share // 6 for share in (1, 3, 5)]
    lens, (_, height) = median_lens(cameras)
    fov = math.degrees(2 * math.atan(height / 2 / float(lens[1, 1])))
    found = []
    for row in rows:
        eye, ahead = cameras.positions[row], cameras.viewmats[row, 2, :3]
        target = eye + ahead
        name = Path(cameras.names[row]).stem
        found.append(Sight(name, tuple(eye.tolist()), tuple(target.tolist()), fov))
    return found


def spark(folder: Path, file: str, sight: Sight) -> str:
    """Write a page of Spark's; its address."""
    width, height = SIZE
    told = {
        **{"width": width, "height": height, "fov": sight.fov, "file": f"./{file}"},
        **{"position": sight.position, "target": sight.target, "up": (0, -1, 0)},
    }
    (folder / "spark.html").write_text(SPARK_PAGE % json.dumps(told))
    return "spark.html"


def supersplat(folder: Path, file: str, sight: Sight) -> str:
    """Write the settings of SuperSplat's viewer; its address. It turns splats half about z."""
    position, target = ((-x, -y, z) for x, y, z in (sight.position, sight.target))
    pose = {"position": position, "target": target, "fov": sight.fov}
    settings: dict[str, Any] = {
        **{"version": 2, "tonemapping": "none", "highPrecisionRendering": False},
        **{"background": {"color": [0, 0, 0]}, "postEffectSettings": effects()},
        **{"animTracks": [], "cameras": [{"initial": pose}], "annotations": []},
        "startMode": "default",
    }
    (folder / "settings.json").write_text(json.dumps(settings))
    return f"viewer/index.html?content=../{file}&settings=../settings.json&noui&webgl&noanim&nofx"


def effects() -> dict[str, Any]:
    """None."""
    zero = {"enabled": False}
    return {
        "sharpness": {**zero, "amount": 0},
        "bloom": {**zero, "intensity": 1, "blurLevel": 2},
        "grading": {**zero, "brightness": 1, "contrast": 1, "saturation": 1, "tint": [1, 1, 1]},
        "vignette": {**zero, "intensity": 0.5, "inner": 0.3, "outer": 0.75, "curvature": 1},
        "fringing": {**zero, "intensity": 0.5},
    }


VIEWERS = {"Spark": (spark, SPARK), "SuperSplat": (supersplat, SUPERSPLAT)}


class Handler(SimpleHTTPRequestHandler):
    """Says nothing, and nothing is kept."""

    def log_message(self, format: str, *args: Any) -> None:
        """Nothing."""

    def end_headers(self) -> None:
        """As each page is written anew."""
        self.send_header("Cache-Control", "no-store")
        super().end_headers()


@contextmanager
def served(folder: Path) -> Iterator[str]:
    """The address of a folder's files."""
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(Handler, directory=str(folder)))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        yield f"http://127.0.0.1:{server.server_port}"
    finally:
        server.shutdown()


def settled(page: Page) -> np.ndarray:
    """The page once it stays as it is."""
    until, last, equal = time.monotonic() + PATIENCE, None, 0
    while time.monotonic() < until:
        time.sleep(1)
        seen = page.screenshot()
        moved = np.inf if last is None else np.abs(seen.astype(int) - last).mean()
        same = moved < ALIKE and seen.std() > 2  # and not all of one colour
        last, equal = seen, equal + 1 if same else 0
        if equal == STILL:
            break
    assert last is not None
    return last


def compared(shown: np.ndarray, expected: np.ndarray, name: str) -> float:
    """PSNR in dB; keeps both and ten times their difference."""
    difference = 10 * np.abs(shown.astype(int) - expected).clip(max=25)
    row = np.concatenate([expected, shown, difference.astype(np.uint8)], axis=1)
    OUT.mkdir(parents=True, exist_ok=True)
    Image.fromarray(row).save(OUT / f"{name}.png")
    return float(psnr(torch.from_numpy(shown) / 255, torch.from_numpy(expected) / 255))


def main(options: Options) -> None:
    """Print a row for each viewer and format."""
    scene = ss.open(options.scene)
    views = sights(scene, options.views)
    rows = []
    with tempfile.TemporaryDirectory() as name, served(Path(name)) as address:
        folder = Path(name)
        (folder / "node_modules").symlink_to((options.npm / "node_modules").resolve())
        package = "node_modules/@playcanvas/supersplat-viewer/public"
        shutil.copytree(folder / package, folder / "viewer")
        for ending in options.formats:
            ss.export(scene, folder / f"splat{ending}")
            splats = read_splats(folder / f"splat{ending}")
            expected = [to_uint8(rasterize(splats, view.camera())[0][0]).numpy() for view in views]
            for viewer, (write, known) in VIEWERS.items():
                if ending not in known:
                    continue
                found = []
                for sight, ours in zip(views, expected, strict=True):
                    with launched(*SIZE) as page:
                        page.open(f"{address}/{write(folder, f'splat{ending}', sight)}")
                        shown = settled(page)
                    kept = f"{viewer}_{sight.name}_{ending.strip('.')}"
                    found.append(compared(shown, ours, kept))
                rows.append([viewer, ending, *(f"{value:.1f}" for value in found)])
                print(*rows[-1], flush=True)
    print(table(["viewer", "file", *(f"{view.name}, dB" for view in views)], rows))


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
