"""The gallery: scenes painted by one command each, as pictures, pages for any browser, and a list.

python scripts/gallery.py benchmarks/out/test_objects ../shared/data/styles -o gallery-output

writes docs/gallery.md and its pictures, and the pages into the output. What the output has is not
painted again. Scenes of photos that are licensed for research alone stay out of docs/.
"""

import argparse
from dataclasses import dataclass
from pathlib import Path

import torch
from PIL import Image

import stylesplat as ss
from stylesplat.figures.best_views import close_up
from stylesplat.selection.resolve import find_object

DOCS = Path(__file__).parents[1] / "docs"
SIDE, QUALITY = 480, 82  # pixels of each picture, and of JPEG
TEXT = """# Gallery

Objects of scenes before and after, each made by the commands under it. `scripts/gallery.py` makes
these pictures, and a page of each scene that any browser opens and turns, as
`stylesplat export SCENE page.html` does. `van_gogh.jpg` and the like stand for pictures of the
paintings below.

Credits. The paintings are in the public domain: Vincent van Gogh, *The Starry Night* (1889);
Wassily Kandinsky, *Composition VII* (1913); Childe Hassam, *The South Ledges, Appledore* (1913);
Claude Monet, *Water Lilies*; Utagawa Kuniyoshi, a woodblock print of Raiko. The doll's photos are
those of noname0310/snowmiku2023plush-splat (MIT). The still life of the vase and the teapot, which
`make demo` trains, and the sign are ray-traced by this project. The rider is a splat of
playcanvas/engine, the brooch one of davidmhart/FastSplatStyler (both MIT). The tankard of the Mary
Rose is trained on the photos of vork/maryRose, published by Daniel Pett
([CC BY 4.0](https://creativecommons.org/licenses/by/4.0/)), and painted here. The bananas' photos
are those of pierotofy/dataset_banana (MIT). Those of the socketed axe are MicroPasts' (access and
photography: Andy Bevan, Chiara Bonacchi, Adi Keinan-Schoonbaert, Dan Pett, Neil Wilkin), those of
the skull are
["Photogrammetry Test Set: Skull - Cameramoves - Flash - No Background"][skull] by
[alansartlog](https://alansartlog.com); both are
[CC BY 4.0](https://creativecommons.org/licenses/by/4.0/), trained and painted here. The fox and the
desk of [other pages](paper.md) are not here: the fox's photos are for non-commercial use, the
desk's state no licence.

[skull]: https://github.com/AlansCodeLog/photogrammetry-test-sets
"""


@dataclass(frozen=True)
class Painting:
    """A picture of the gallery."""

    scene: str
    styles: dict[str, str]
    """The beginning of a painting's file name, by object."""
    title: str
    made_by: tuple[str, ...] = ()
    """The commands that make the scene."""
    is_free: bool = True
    """Whether the scene's pictures may be published."""

    @property
    def name(self) -> str:
        """Of its files."""
        return "-".join([Path(self.scene).parts[0], *self.styles.values()])


DEMO = ("stylesplat demo -o demo",)
DOLL = (
    "stylesplat sfm DollPhotos -o doll_capture",
    "stylesplat mask doll_capture --box doll=20240212_003919.jpg:295,130,830,670",
    "stylesplat train doll_capture -o doll --steps 3000",
)
TANKARD = (
    "stylesplat sfm TankardPhotos -o tankard_capture",
    "stylesplat mask tankard_capture --box tankard=IMG_9678.JPG:104,696,3400,2960",
    "stylesplat train tankard_capture -o tankard --steps 3000",
)
BANANAS = (
    "stylesplat sfm BananaPhotos -o bananas_capture",
    "stylesplat mask bananas_capture --box bananas=DSC_0426.JPG:270,400,2220,1670",
    "stylesplat train bananas_capture -o bananas --steps 1500 --downscale 4",
)
AXE = (
    "stylesplat sfm AxePhotos -o axe_capture --masks AxeMasks",
    "stylesplat mask axe_capture --from AxeMasks",
    "stylesplat train axe_capture -o axe --steps 1500 --downscale 6 --max-gaussians 40000",
)
SKULL = (
    "stylesplat sfm SkullPhotos -o skull_capture",
    "stylesplat mask skull_capture --box skull=21.JPG:1170,490,3420,2330",
    "stylesplat train skull_capture -o skull --steps 1500 --downscale 5 --max-gaussians 40000",
)
SIGN = (
    "python benchmarks/traced_objects.py --shape sign --folder sign_capture",
    "stylesplat train sign_capture -o sign --steps 3000",
)
RIDER = (
    "stylesplat import biker.compressed.ply -o rider",
    "stylesplat select rider --name rider --point view_000.png:360,400",
)
BROOCH = (
    "stylesplat import broche.splat -o brooch",
    "stylesplat select brooch --name brooch --size group --point view_000.png:530,440",
)
PAINTINGS = (
    Painting("demo/scene", {"vase": "van_gogh"}, "A vase in van Gogh's strokes", DEMO),
    Painting(
        "demo/scene", {"vase": "kandinsky", "teapot": "monet"}, "Two objects in two styles", DEMO
    ),
    Painting("doll", {"doll": "ukiyo_e"}, "A plush doll, from 49 phone photos", DOLL),
    Painting("doll", {"doll": "van_gogh"}, "The same doll in another style", DOLL),
    Painting("tankard", {"tankard": "hassam"}, "A tankard of 1545, from 69 photos", TANKARD),
    Painting("tankard", {"tankard": "monet"}, "The tankard in another style", TANKARD),
    Painting("bananas", {"bananas": "van_gogh"}, "Bananas on a carpet, from 16 photos", BANANAS),
    Painting("bananas", {"bananas": "kandinsky"}, "The bananas in another style", BANANAS),
    Painting("axe", {"1": "kandinsky"}, "A bronze axe, from 52 photos with masks", AXE),
    Painting("skull", {"skull": "van_gogh"}, "A skull, from 66 photos without a room", SKULL),
    Painting("skull", {"skull": "hassam"}, "The skull in another style", SKULL),
    Painting("rider", {"rider": "hassam"}, "A rider, a splat of somebody else", RIDER),
    Painting("rider", {"rider": "kandinsky"}, "The rider in another style", RIDER),
    Painting("brooch", {"brooch": "ukiyo_e"}, "A brooch of open-work, from a .splat file", BROOCH),
    Painting("brooch", {"brooch": "van_gogh"}, "The brooch in another style", BROOCH),
    Painting("sign", {"1": "kandinsky"}, "A sign on thin legs", SIGN),
    Painting("fox", {"1": "van_gogh"}, "A fox's head", is_free=False),
    Painting("desk", {"1": "kandinsky"}, "A bottle on a desk", is_free=False),
)


def painted(each: Painting, scenes: Path, paintings: Path, folder: Path) -> ss.Scene:
    """The painted scene, from the folder if it is there."""
    if folder.exists():
        return ss.open(folder)
    found = {name: next(paintings.glob(f"{style}*")) for name, style in each.styles.items()}
    scene = ss.stylize(ss.open(scenes / each.scene), found, measured=False)
    ss.save(scene, folder)
    return ss.open(folder)


def before_and_after(scene: ss.Scene, names: list[str]) -> Image.Image:
    """Close-ups of the objects side by side."""
    before = ss.adjust(scene, undo=True)
    picked = torch.stack([find_object(before, name) for name in names]).any(dim=0)
    camera = close_up(before.splats, before.cameras, picked, side=SIDE)
    pictures = [picture for each in (before, scene) for _, picture in ss.render(each, camera)]
    return Image.fromarray(torch.cat(pictures, dim=1).numpy())


def main() -> None:
    """Paint what is not there yet, and write everything else anew."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenes", type=Path, help="folder of the trained scenes")
    parser.add_argument("paintings", type=Path, help="folder of the paintings")
    parser.add_argument("-o", "--output", type=Path, default=Path("gallery-output"))
    options = parser.parse_args()
    (DOCS / "gallery").mkdir(exist_ok=True)
    for each in PAINTINGS:
        scene = painted(each, options.scenes, options.paintings, options.output / each.name)
        page = options.output / f"{each.name}.html"
        ss.export(scene, page, sh_degree=0, overwrite=True)
        picture = (DOCS / "gallery" if each.is_free else options.output) / f"{each.name}.jpg"
        before_and_after(scene, [*each.styles]).save(picture, quality=QUALITY)
        print(f"{picture}  {page}: {page.stat().st_size / 2**20:.1f} MB", flush=True)
        write_list()


def write_list() -> None:
    """Write the page of all pictures that are there."""
    parts = [TEXT]
    for each in PAINTINGS:
        picture = f"gallery/{each.name}.jpg"
        if (DOCS / picture).is_file():
            styles = (f"--style {name}={style}.jpg" for name, style in each.styles.items())
            paint = " ".join(["stylesplat stylize", each.scene, *styles, "-o painted"])
            commands = "\n".join([*each.made_by, paint])
            title = f"## {each.title}\n\n![{each.title}, before and after]({picture})"
            parts.append(f"{title}\n\n```sh\n{commands}\n```\n")
    (DOCS / "gallery.md").write_text("\n".join(parts), encoding="utf-8")


if __name__ == "__main__":
    main()
