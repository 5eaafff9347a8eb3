"""`stylesplat export`."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal

from tyro.conf import FlagCreatePairsOff, Positional, UseAppendAction

from stylesplat.cli.next_steps import next_lines, size_of, unused
from stylesplat.cli.options import Json, OptionalOutput, Overwrite, Verbose
from stylesplat.errors import StyleSplatError
from stylesplat.scene.arguments import pasted


@dataclass(frozen=True)
class Export:
    """Write a scene's splat for other programs, or as a web page that shows it.

    Example: stylesplat export garden-wave garden.html
    """

    first: ClassVar = ("output", "object")
    scene: Positional[Path]
    """Folder of the scene."""
    file: Positional[Path | None] = None
    """File to make: .ply keeps every bit; .compressed.ply, .spz, .splat and .sog are smaller; .glb
    and .gltf are glTF; .html is a page for any browser, with before and
    after; .npz and .json list the objects' Gaussians. Or name it with -o."""
    output: OptionalOutput = None
    """File to make, where it does not follow the scene."""
    object: UseAppendAction[tuple[str, ...]] = ()
    """Write this object alone, where it lies in the scene. May be repeated."""
    without: UseAppendAction[tuple[str, ...]] = ()
    """Leave this object out. May be repeated."""
    each: Path | None = None
    """Folder to make instead of a file: each object in a .ply of its name, the rest in rest.ply."""
    selected: UseAppendAction[tuple[str, ...]] = ()
    """In a .ply, have this object selected when SuperSplat opens it. May be repeated."""
    columns: FlagCreatePairsOff[bool] = False
    """In a .ply, have columns label and share: what object, and how much of each Gaussian it is."""
    sidecar: FlagCreatePairsOff[bool] = False
    """Write FILE.objects.npz beside it, for `import --labels`: the objects, by rows of the file."""
    sh_degree: Literal[0, 1, 2, 3] | None = None
    """Leave out how colours change with the view, above this degree; 0 keeps one colour each."""
    overwrite: Overwrite = False
    verbose: Verbose = False
    json: Json = False

    def run(self) -> dict[str, Any]:
        """Do it."""
        from stylesplat.io.atomic import refuse_file
        from stylesplat.io.gaussian_lists import SUFFIXES
        from stylesplat.io.scene_folder import open
        from stylesplat.verbs.export import export, export_each, export_objects

        file, options = self._place(), {"overwrite": self.overwrite, "sh_degree": self.sh_degree}
        if self.each is not None:
            files = export_each(open(self.scene), self.each, **options)
            return {"files": files}
        refuse_file(file, overwrite=self.overwrite)
        scene = open(self.scene)
        if file.suffix.lower() in SUFFIXES:
            self._refuse_idle(file)
            objects = export_objects(scene, file, objects=self.object, overwrite=self.overwrite)
            return {"file": file, "objects": objects}
        count = export(
            scene,
            file,
            objects=self.object,
            without=self.without,
            selected=self.selected,
            columns=self.columns,
            sidecar=self.sidecar,
            **options,
        )
        return {"file": file, "gaussians": count}

    def _refuse_idle(self, file: Path) -> None:
        """Raise a StyleSplatError for options that lists of objects have not."""
        others = (self.without, self.selected, self.columns, self.sidecar)
        if any(others) or self.sh_degree is not None:
            raise StyleSplatError(f"{file} lists objects. Of the options it takes --object alone.")

    def _place(self) -> Path:
        """The file or the folder to make."""
        places = [each for each in (self.file, self.output, self.each) if each is not None]
        if len(places) != 1:
            raise StyleSplatError(f"Name one file: `stylesplat export {self.scene} FILE`.")
        idle = (self.object, self.without, self.selected, self.columns, self.sidecar)
        if self.each is not None and any(idle):
            raise StyleSplatError(
                "--each writes every object by itself. Leave --object, --without, --selected, "
                "--columns and --sidecar out."
            )
        return places[0]

    def words(self, result: dict[str, Any]) -> Iterator[str]:
        """What was made, and how to go on."""
        from stylesplat.scene.one_line import counted

        if "files" in result:
            yield f"{self.each}: {', '.join(path.name for path in result['files'])}."
            return
        file = result["file"]
        if "objects" in result:
            yield f"{file}: {counted(result['objects'], 'object')}, {size_of(file)}."
            return
        count = f"{result['gaussians']:,} Gaussians, {size_of(file)}"
        plain = file.suffix == ".ply" and not file.name.endswith(".compressed.ply")
        opened_by = "SuperSplat opens it"
        if file.suffix.lower() in (".glb", ".gltf"):
            opened_by = "What knows KHR_gaussian_splatting opens it, the rest shows points"
        if file.suffix.lower() == ".html":
            opened_by = "Any browser opens it, without a network"
        if plain and self.sh_degree is None:
            opened_by = "SuperSplat, Blender and other programs open it"
        yield f"{file}: {count}. {opened_by}."
        if self.sidecar:
            yield f"Objects: {file}.objects.npz, for `import --labels`."
        video = unused(self.scene, ".mp4")
        yield from next_lines(pasted("render", self.scene, "-o", video, "--views", "orbit"))
