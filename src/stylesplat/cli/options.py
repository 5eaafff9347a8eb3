"""The base of all commands, and options that several verbs share."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from tyro.conf import Positional, arg

from stylesplat.cli.results import Answer, rewrite_scene
from stylesplat.errors import StyleSplatError
from stylesplat.io.atomic import refuse_file
from stylesplat.stylization.config import Network

if TYPE_CHECKING:
    from stylesplat.scene.scene import Scene

SceneFolder = Annotated[Positional[Path], arg(help="Folder of the scene.")]
Output = Annotated[Path, arg(aliases=["-o"])]
OptionalOutput = Annotated[Path | None, arg(aliases=["-o"])]
Device = Annotated[
    Literal["auto", "cpu", "cuda"],
    arg(help="Where to compute; auto uses an NVIDIA GPU if there is one."),
]
StylePreset = Annotated[
    Literal["default", "paper"],
    arg(help="Settings to start from; paper is the method as published, with --features vgg16."),
]
Features = Annotated[
    Network | None,
    arg(
        help="Network whose features are matched: by default compact, which ships with the "
        "package, or vgg16 with --preset paper."
    ),
]
Weights = Annotated[
    Path | None,
    arg(
        help="File of the network's weights (.safetensors, .pth); without it VGG's are downloaded "
        "once."
    ),
]
PICTURES = (".png", ".jpg", ".jpeg", ".webp")
NAMES = {"source": "from"}  # of options that are no names in Python
CONTINUES = "The same command goes on where it stopped."  # after Ctrl-C


@dataclass(frozen=True, kw_only=True)
class Command:
    """A verb of the command line: its fields are its options."""

    json: Annotated[bool, arg(help="Print the result as JSON on stdout.")] = False

    def run(self) -> Answer:
        """Run the verb."""
        raise NotImplementedError

    def after_answer(self, values: dict[str, Any]) -> None:
        """Do what nobody has to wait for: the answer with these values is printed already."""

    def refuse_given(self, names: tuple[str, ...], why: str) -> None:
        """Raise a StyleSplatError if an option is given that would change nothing."""
        for name in names:
            if getattr(self, name):
                option = NAMES.get(name, name).replace("_", "-")
                raise StyleSplatError(f"--{option} means nothing with {why}. Leave it out.")


@dataclass(frozen=True, kw_only=True)
class MakingCommand(Command):
    """A verb that makes files."""

    overwrite: Annotated[bool, arg(help="Replace what the output holds.")] = False

    def refuse_picture(self, output: Path) -> None:
        """Raise a StyleSplatError if no picture can be written to a file."""
        if output.suffix.lower() not in PICTURES:
            names = ", ".join(PICTURES)
            raise StyleSplatError(f"Cannot draw into {output}: use a name in {names}.")
        refuse_file(output, overwrite=self.overwrite)


@dataclass(frozen=True)
class EditingCommand(MakingCommand):
    """A verb that changes a scene, or makes another one of it."""

    scene: SceneFolder
    output: Annotated[
        OptionalOutput, arg(help="Folder of a scene to make; without it the scene itself changes.")
    ] = field(default=None, kw_only=True)

    @property
    def folder(self) -> Path:
        """Of the scene that changes, or is made."""
        return self.output or self.scene

    def rewrite(self, change: "Callable[[Scene], Scene]") -> "Scene":
        """Open the scene, change it, and save it."""
        return rewrite_scene(self.scene, self.output, change, overwrite=self.overwrite)
