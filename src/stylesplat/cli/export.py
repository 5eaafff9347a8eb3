"""`stylesplat export`."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

from tyro.conf import Positional, UseAppendAction

import stylesplat as ss
from stylesplat.cli.arguments import from_config
from stylesplat.cli.options import MakingCommand, OptionalOutput, SceneFolder
from stylesplat.cli.results import Answer, next_command
from stylesplat.errors import StyleSplatError
from stylesplat.io.atomic import refuse_file
from stylesplat.meshes.mesh_config import MeshConfig

MESH_SETTINGS = from_config(MeshConfig, "faces", "texture_size", "repaint")


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
    mesh_settings: Annotated[dict[str, Any], MESH_SETTINGS] = field(default_factory=dict)
    spz_version: Literal[2, 3, 4] | None = None
    """Version of a .spz: 4 by default; 3 for ComfyUI and Spark 2.2, 2 for older programs. With 2 a
    .glb or .gltf holds SPZ, as Cesium wants it."""

    def run(self) -> Answer:
        from stylesplat.io.gaussian_lists import LISTS
        from stylesplat.scene.one_line import counted
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
        lines = [f"{file}: {counted(count, noun)}, {file.stat().st_size / 1e6:.1f} MB."]
        if self.sidecar:
            lines.append(f"Objects: {file}.objects.npz, for `import --labels`.")
        values = {"file": file, f"{noun.lower()}s": count}
        return Answer(values, lines, [next_command("render", self.scene, "--views", "orbit")])
