"""Buttons: each writes the splat and its selection to files, and reads what the program made."""

import tempfile
import time
from pathlib import Path

import bpy
import numpy as np

from . import program, splats

PROGRAM = "stylesplat"
TICK = 0.2  # seconds between two looks at the program
OBJECT, LAYER = "OBJECT", "LAYER"


def choices(*names: str) -> list[tuple[str, str, str]]:
    """The items of an EnumProperty whose names are the program's own words."""
    return [(name, name.capitalize(), "") for name in names]


class Settings(bpy.types.PropertyGroup):
    """What the panel shows; ranges and defaults are those of the program."""

    result: bpy.props.EnumProperty(
        name="Result",
        items=[
            (OBJECT, "New object", "A copy of the object, which is hidden then"),
            (LAYER, "Attribute layer", "The object itself; Revert gives back what was before"),
        ],
    )
    picture: bpy.props.StringProperty(
        name="Picture",
        subtype="FILE_PATH",
        description="To take the style from; or material:bronze, marble, gold-leaf, clay, jade",
    )
    stroke_size: bpy.props.FloatProperty(name="Stroke size", default=2, min=0.1, max=20)
    intensity: bpy.props.FloatProperty(name="Intensity", default=1, min=0, max=1.5)
    form: bpy.props.FloatProperty(name="Keep form", default=1, min=0, max=1.5)
    color: bpy.props.EnumProperty(name="Colours", items=choices("style", "keep", "blend", "free"))
    quality: bpy.props.EnumProperty(name="Quality", items=choices("normal", "draft", "high"))
    seed: bpy.props.IntProperty(name="Seed", min=0)
    hue: bpy.props.FloatProperty(name="Hue", min=-180, max=180)
    saturation: bpy.props.FloatProperty(name="Saturation", default=1, min=0, max=4)
    brightness: bpy.props.FloatProperty(name="Brightness", default=1, min=0, max=4)
    contrast: bpy.props.FloatProperty(name="Contrast", default=1, min=0, max=4)
    temperature: bpy.props.FloatProperty(name="Warmth", min=-1, max=1)
    tint: bpy.props.StringProperty(name="Tint", description="#rrggbb or the name of a colour")
    swap: bpy.props.StringProperty(
        name="Swap",
        description="Main colours that become others, shades and highlights kept: #a02020=teal",
    )
    faces: bpy.props.IntProperty(name="Faces", default=50_000, min=100, max=1_000_000)
    texture_size: bpy.props.EnumProperty(
        name="Texture", items=choices("2048", "1024", "4096", "512", "256")
    )


def program_name() -> str:
    """What the preferences say."""
    addon = bpy.context.preferences.addons.get(__package__)
    return addon.preferences.program if addon else PROGRAM


def up_of(thing: bpy.types.Object) -> str:
    """The axis of the object that points upwards in the world, such as -y."""
    up = np.array(thing.matrix_world.inverted_safe().to_3x3())[:, 2]
    axis = int(abs(up).argmax())
    return ("-" if up[axis] < 0 else "") + "xyz"[axis]


class SplatOperator:
    """An operator that waits for the program, with a progress bar; Esc cancels it."""

    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012  (Blender's own form)

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Whether the active object is a splat."""
        return splats.kind_of(context.object) is not None

    def commands(self, folder: Path, up: str, settings: Settings) -> list:
        """What the program is to do."""
        raise NotImplementedError

    def finish(self, context: bpy.types.Context) -> None:
        """Take the result out of the folder."""
        raise NotImplementedError

    def start(self, context: bpy.types.Context) -> None:
        """Write the splat and begin. Raises a ProgramError for what the user can mend."""
        path, self.thing = program.find_program(program_name()), context.object
        if self.thing.mode != "OBJECT":  # which gives the selection
            bpy.ops.object.mode_set(mode="OBJECT")
        rows = splats.selected(self.thing)
        if not rows.any():
            raise program.ProgramError("Nothing is selected. Select points in edit mode.")
        self.kind, self.before = splats.kind_of(self.thing), splats.table_of(self.thing)
        self.temporary = tempfile.TemporaryDirectory(prefix="stylesplat-")
        self.folder = Path(self.temporary.name)
        splats.write_ply(self.before, self.folder / "in.ply")
        np.save(self.folder / "rows.npy", rows)
        commands = self.commands(self.folder, up_of(self.thing), context.scene.stylesplat)
        self.job = program.Job(path, commands)

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Without a window: wait until it is done."""
        try:
            self.start(context)
            while not self.job.poll():
                time.sleep(TICK)
            self.finish(context)
        except program.ProgramError as error:
            return self.fail(str(error))
        self.temporary.cleanup()
        return {"FINISHED"}

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """In a window: look at the program now and then."""
        if bpy.app.background or context.window is None:
            return self.execute(context)
        try:
            self.start(context)
        except program.ProgramError as error:
            return self.fail(str(error))
        manager = context.window_manager
        self.timer = manager.event_timer_add(TICK, window=context.window)
        manager.progress_begin(0, 100)
        manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Each tick; Esc ends the program."""
        if event.type == "ESC":
            self.job.cancel()
            self.end(context)
            self.report({"INFO"}, "Cancelled: nothing has changed.")
            return {"CANCELLED"}
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        try:
            is_done = self.job.poll()
            context.window_manager.progress_update(round(100 * self.job.progress))
            share = f"{self.job.progress:.0%}: {self.job.line}"
            context.workspace.status_text_set(f"StyleSplat: {share} (Esc cancels)")
            if not is_done:
                return {"RUNNING_MODAL"}
            self.finish(context)
        except (program.ProgramError, ReferenceError) as error:  # or the object was removed
            self.end(context)
            return self.fail(str(error))
        self.end(context)
        return {"FINISHED"}

    def end(self, context: bpy.types.Context) -> None:
        """Take the bar away, and the files."""
        context.window_manager.event_timer_remove(self.timer)
        context.window_manager.progress_end()
        context.workspace.status_text_set(None)
        self.temporary.cleanup()

    def fail(self, line: str) -> set[str]:
        """Show what is wrong; nothing has changed."""
        self.report({"ERROR"}, line)
        if hasattr(self, "temporary"):
            self.temporary.cleanup()
        return {"CANCELLED"}


class ColorOperator(SplatOperator):
    """An operator whose result is a splat."""

    suffix = ""

    def finish(self, context: bpy.types.Context) -> None:
        """Make a new object, or a layer of attributes."""
        after = splats.read_ply(self.folder / "out.ply")
        thing = self.thing
        if context.scene.stylesplat.result == LAYER:
            if len(after) > len(self.before):
                raise program.ProgramError(
                    "Paint of this quality has points of its own, which a layer cannot hold. "
                    "Choose the quality Draft, or New object."
                )
            splats.keep(thing.data, self.kind, self.before)
            splats.apply(thing.data, self.kind, self.before, after)
            return
        new = thing.copy()
        new.data = thing.data.copy()
        new.name = new.data.name = f"{thing.name} {self.suffix}"
        splats.apply(new.data, self.kind, self.before, after)
        for collection in thing.users_collection:
            collection.objects.link(new)
        thing.select_set(False)
        thing.hide_set(True)
        thing.hide_render = True
        new.select_set(True)
        context.view_layer.objects.active = new


class Stylize(ColorOperator, bpy.types.Operator):
    """Repaint the selected points in the style of a picture; the others stay to the bit."""

    bl_idname, bl_label, suffix = "stylesplat.stylize", "Stylize selection", "painted"

    def commands(self, folder: Path, up: str, settings: Settings) -> list:
        """`stylize`."""
        picture = settings.picture
        if not picture:
            raise program.ProgramError("There is no picture to take a style from. Choose one.")
        if not picture.startswith("material:"):
            picture = bpy.path.abspath(picture)
        options = {
            "stroke-size": round(settings.stroke_size, 6),
            "intensity": round(settings.intensity, 6),
            "form": round(settings.form, 6),
            "color": settings.color,
            "quality": settings.quality,
            "seed": settings.seed,
        }
        return program.paint_commands(folder, up, picture, options)


class Recolor(ColorOperator, bpy.types.Operator):
    """Change the colours of the selected points; the others stay to the bit."""

    bl_idname, bl_label, suffix = "stylesplat.recolor", "Recolor selection", "recolored"

    def commands(self, folder: Path, up: str, settings: Settings) -> list:
        """`recolor`."""
        names = ("hue", "saturation", "brightness", "contrast", "temperature")
        options: dict = {name: round(getattr(settings, name), 6) for name in names}
        if settings.tint:
            options["tint"] = settings.tint
        options["swap"] = settings.swap.replace(",", " ").split()
        return program.recolor_commands(folder, up, options)


class Mesh(SplatOperator, bpy.types.Operator):
    """Make a textured mesh of the selected points, as a new object at their place."""

    bl_idname, bl_label = "stylesplat.mesh", "Mesh of selection"

    def commands(self, folder: Path, up: str, settings: Settings) -> list:
        """`export --mesh`."""
        return program.mesh_commands(folder, up, settings.faces, int(settings.texture_size))

    def finish(self, context: bpy.types.Context) -> None:
        """Import it at the place of the splat, and pack the texture into Blender's file.

        The program turns meshes by half a turn about z, from y down to y up.
        """
        known = {*bpy.data.objects}
        path = str(self.folder / "mesh.obj")
        bpy.ops.wm.obj_import(filepath=path, forward_axis="NEGATIVE_Y", up_axis="Z")
        (new,) = {*bpy.data.objects} - known
        new.name = new.data.name = f"{self.thing.name} mesh"
        new.matrix_world = self.thing.matrix_world @ new.matrix_world  # which has the half turn
        for slot in new.material_slots:
            for node in slot.material.node_tree.nodes:
                if node.type == "TEX_IMAGE" and node.image is not None:
                    node.image.pack()


class Revert(bpy.types.Operator):
    """Give an object back the attributes from before its first layer."""

    bl_idname, bl_label = "stylesplat.revert", "Revert layer"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012  (Blender's own form)

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Whether the active object is a splat."""
        return splats.kind_of(context.object) is not None

    def execute(self, context: bpy.types.Context) -> set[str]:
        """To the bit."""
        if not splats.restore(context.object.data):
            self.report({"ERROR"}, "This object has no layer of attributes.")
            return {"CANCELLED"}
        return {"FINISHED"}


OPERATORS = (Stylize, Recolor, Mesh, Revert)
