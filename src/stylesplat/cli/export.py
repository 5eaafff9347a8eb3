"""`stylesplat export`."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

from tyro.conf import Positional, UseAppendAction, arg

import stylesplat as ss
from stylesplat.cli.arguments import from_config, help_texts
from stylesplat.cli.options import MakingCommand, OptionalOutput, SceneFolder, refuse_given
from stylesplat.cli.results import next_lines, pasted, unused
from stylesplat.errors import StyleSplatError
from stylesplat.io.atomic import refuse_file
from stylesplat.meshes.mesh_config import MeshConfig


@dataclass(frozen=True)
class Export(MakingCommand):
    """Write a scene's splat for other programs, or as a web page that shows it.

    Example: stylesplat export garden-wave garden.html
    """

    scene: SceneFolder
    file: Positional[Path | None] = None
    """File to make: .ply keeps every bit; .compressed.ply, .spz, .splat and .sog are smaller; .glb
    and .gltf are glTF; .html is a page for any browser, with before and
    after; .npz lists the objects' Gaussians. Or name it with -o."""
    output: OptionalOutput = None
    """File to make, where it does not follow the scene."""
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
    mesh_settings: Annotated[dict[str, Any], from_config(MeshConfig, "faces", "texture_size")] = (
        field(default_factory=dict)
    )
    repaint: Annotated[bool, arg(help=help_texts(MeshConfig)["repaint"])] = False
    spz_version: Literal[2, 3, 4] | None = None
    """Version of a .spz: 4 by default; 3 for ComfyUI and Spark 2.2, 2 for older programs. With 2 a
    .glb or .gltf holds SPZ, as Cesium wants it."""

    def run(self) -> dict[str, Any]:
        from stylesplat.io.gaussian_lists import LISTS
        from stylesplat.verbs.export import export_each

        places = [each for each in (self.file, self.output, self.each) if each is not None]
        if len(places) != 1:
            raise StyleSplatError(f"Name one file: `stylesplat export {self.scene} FILE`.")
        (file,) = places
        settings = self.mesh_settings | ({"repaint": True} if self.repaint else {})
        if settings and not self.mesh:
            names = ", ".join(f"--{name.replace('_', '-')}" for name in settings)
            raise StyleSplatError(f"{names} means nothing without --mesh. Add it, or leave it out.")
        options = {"overwrite": self.overwrite, "sh_degree": self.sh_degree}
        if self.each is not None:
            whole = ("object", "without", "selected", "sidecar", "mesh", "spz_version")
            refuse_given(self, whole, "--each")
            return {"files": export_each(ss.open(self.scene), file, **options)}
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
        return {"file": file, "faces" if self.mesh else "objects" if lists else "gaussians": count}

    def words(self, result: dict[str, Any]) -> Iterator[str]:
        from stylesplat.scene.one_line import counted

        if "files" in result:
            yield f"{self.each}: {', '.join(path.name for path in result['files'])}."
            return
        file, (what, count) = result["file"], [*result.items()][1]
        noun = {"gaussians": "Gaussian"}.get(what, what[:-1])
        yield f"{file}: {counted(count, noun)}, {file.stat().st_size / 1e6:.1f} MB."
        if self.sidecar:
            yield f"Objects: {file}.objects.npz, for `import --labels`."
        video = unused(self.scene, ".mp4")
        yield from next_lines(pasted("render", self.scene, "-o", video, "--views", "orbit"))
