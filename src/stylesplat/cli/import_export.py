"""`stylesplat import` and `export`."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

from tyro.conf import Positional, UseAppendAction

import stylesplat as ss
from stylesplat.cli.arguments import from_config
from stylesplat.cli.command import (
    Answer,
    Device,
    MakingCommand,
    OptionalOutput,
    Output,
    SceneFolder,
    describe_scene,
    new_scene,
    next_command,
    shell_command,
)
from stylesplat.errors import StyleSplatError
from stylesplat.io.atomic import refuse_file
from stylesplat.meshes.mesh_config import MeshConfig


@dataclass(frozen=True)
class Import(MakingCommand):
    """Make a scene of a splat that exists already, without training.

    Example: stylesplat import garden.ply garden -o garden-scene
    """

    splat: Positional[Path]
    """A .ply (also SuperSplat's compressed one), .spz, .splat, .ksplat, .sog, .glb, .gltf or .usd*
    file, the meta.json of a SOG folder, the lod-meta.json of a streamed SOG, or a checkpoint:
    gsplat's .pt, splatfacto's .ckpt."""
    output: Output
    """Folder of the scene to make."""
    capture: Positional[Path | None] = None
    """Folder with the posed photos that it was made from, and label maps in object_mask/. Without
    it the scene gets views around the content, which `mask` takes for photos."""
    up: Literal["x", "-x", "y", "-y", "z", "-z"] | None = None
    """The axis that points up, where there is no capture; by default what the file says, or -y."""
    frame: Literal["capture", "nerfstudio", "nerfstudio-axes", "nerfstudio-colmap"] = "capture"
    """World frame of the splat; an import that does not fit says which one does."""
    like: Path | None = None
    """Folder of the scene that another program made this splat of, by removing, adding, reordering
    or moving Gaussians: its views, objects and paintings are carried over."""
    masks: Path | None = None
    """Folder of label maps; by default the capture's object_mask/."""
    labels: Path | None = None
    """File of one label id per Gaussian, in the splat's order: .npy, .npz, or a .ply with
    the column label or object_id; or of objects, as `export` writes them. It takes the place of
    label maps."""
    device: Device = "auto"

    def run(self) -> Answer:
        if self.capture is None or self.labels is not None:
            self.refuse_given(("masks",), "no capture" if self.capture is None else "--labels")
        with new_scene(self.output, overwrite=self.overwrite) as save:
            capture = self.capture and ss.load(self.capture, masks=self.masks)
            scene = ss.import_(
                self.splat,
                capture,
                frame=self.frame,
                up=self.up,
                labels=self.labels,
                like=self.like and ss.open(self.like),
                device=self.device,
            )
            save(scene)
            photos = self.capture is not None or self.like is not None
            about = describe_scene(scene, capture, self.output, device=self.device, photos=photos)
        lines = [*self._lines(scene.metrics), *about.lines]
        return Answer({**scene.metrics, **about.values}, lines, about.following)

    def _lines(self, metrics: Mapping[str, Any]) -> Iterator[str]:
        close = f", {metrics['psnr']:.1f} dB from the photos" if "psnr" in metrics else ""
        yield f"{self.output}: {metrics['gaussians']:,} Gaussians{close}."
        if self.like is not None:
            yield (
                f"{metrics['matched']:,} of them are of {self.like}, {metrics['new_gaussians']:,} "
                f"are new; {metrics['lost_gaussians']:,} of its Gaussians are gone."
            )
            for part in metrics["moved"]:
                turn = f"turned by {part['degrees']:.4g} degrees, scaled by {part['scale']:.4g}"
                yield f"Moved: {part['gaussians']:,} Gaussians, {turn}."
        elif self.capture is None and self.up is None:
            from stylesplat.io.splats.splat_files import declared_up

            labels = ("--labels", self.labels) if self.labels else ()
            other = "-y" if declared_up(self.splat) == "z" else "z"
            again = shell_command("import", self.splat, *labels, "-o", self.output, "--up", other)
            yield f"If it lies on its side: {again} --overwrite"


@dataclass(frozen=True)
class Export(MakingCommand):
    """Write a scene's splat for other programs, or as a web page that shows it.

    Example: stylesplat export garden-wave garden.html
    """

    scene: SceneFolder
    file: Positional[Path | None] = None
    """File to make: .ply keeps every bit; .compressed.ply, .spz, .splat and .sog are smaller; .glb
    and .gltf are glTF; .usdz, .usdc and .usda are USD; .html is a page for any browser, with before
    and after; .npz lists the objects' Gaussians. Or name it with -o."""
    output: OptionalOutput = None
    """File to make, if it is not the second argument."""
    object: UseAppendAction[tuple[str, ...]] = ()
    """Write this object alone, where it lies in the scene. May be repeated."""
    without: UseAppendAction[tuple[str, ...]] = ()
    """Leave this object out. May be repeated."""
    each: Path | None = None
    """Folder to make instead of a file: each object in a .ply of its name, the rest in rest.ply."""
    selected: UseAppendAction[tuple[str, ...]] = ()
    """Select this object for SuperSplat, in a .ply. May be repeated."""
    sidecar: bool = False
    """Write FILE.objects.npz beside it, for `import --labels`: the objects, by rows of the file."""
    sh_degree: Literal[0, 1, 2, 3] | None = None
    """Leave out how colours change with the view, above this degree; 0 keeps one colour each."""
    mesh: bool = False
    """Write a textured mesh into a .glb or .obj, of one object or of a scene that shows one."""
    mesh_settings: Annotated[dict[str, Any], from_config(MeshConfig)] = field(default_factory=dict)
    spz_version: Literal[2, 3, 4] | None = None
    """Version of a .spz: 4 by default; 3 for ComfyUI and Spark 2.2, 2 for older programs. With 2 a
    .glb or .gltf holds SPZ, as Cesium wants it."""

    def run(self) -> Answer:
        from stylesplat.errors import count_noun
        from stylesplat.io.gaussian_lists import LISTS
        from stylesplat.verbs.export import export_each

        places = [each for each in (self.file, self.output, self.each) if each is not None]
        if len(places) != 1:
            raise StyleSplatError(f"Name one file: `stylesplat export {self.scene} FILE`.")
        (file,) = places
        settings = self.mesh_settings
        given = [f"--{name.replace('_', '-')}" for name, value in settings.items() if value]
        if given and not self.mesh:
            names = ", ".join(given)
            raise StyleSplatError(f"{names} means nothing without --mesh. Add it, or leave it out.")
        options = {"overwrite": self.overwrite, "sh_degree": self.sh_degree}
        if self.each is not None:
            whole = ("object", "without", "selected", "sidecar", "mesh", "spz_version")
            self.refuse_given(whole, "--each")
            files = export_each(ss.open(self.scene), file, **options)
            names = ", ".join(path.name for path in files)
            return Answer({"files": files}, [f"{file}: {names}."])
        refuse_file(file, overwrite=self.overwrite)
        count = ss.export(
            ss.open(self.scene),
            file,
            objects=self.object,
            without=self.without,
            selected=self.selected,
            sidecar=self.sidecar,
            mesh=MeshConfig(**settings) if self.mesh else None,
            spz_version=self.spz_version,
            **options,
        )
        lists = file.suffix.lower() == LISTS
        noun = "face" if self.mesh else "object" if lists else "Gaussian"
        lines = [f"{file}: {count_noun(count, noun)}, {file.stat().st_size / 1e6:.1f} MB."]
        if self.sidecar:
            lines.append(f"Objects: {file}.objects.npz, for `import --labels`.")
        values = {"file": file, f"{noun.lower()}s": count}
        return Answer(values, lines, [next_command("render", self.scene, "--views", "orbit")])
