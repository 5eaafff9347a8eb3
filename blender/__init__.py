"""Paints, recolours and meshes the selected points of a splat, by the program `stylesplat`."""

import bpy

from . import operators


class StyleSplatPreferences(bpy.types.AddonPreferences):
    """Where the program is."""

    bl_idname = __package__

    program: bpy.props.StringProperty(
        name="Program",
        description="The name of the program on the PATH, or its file",
        default=operators.PROGRAM,
        subtype="FILE_PATH",
    )

    def draw(self, context: bpy.types.Context) -> None:
        """The only setting."""
        self.layout.prop(self, "program")


class StyleSplatPanel(bpy.types.Panel):
    """The tab StyleSplat in the sidebar of the 3D viewport."""

    bl_idname = "VIEW3D_PT_stylesplat"
    bl_label = "StyleSplat"
    bl_space_type, bl_region_type, bl_category = "VIEW_3D", "UI", "StyleSplat"

    def draw(self, context: bpy.types.Context) -> None:
        """Settings, and a button for each operator."""
        settings, column = context.scene.stylesplat, self.layout.column()
        column.prop(settings, "result")
        boxes = {
            "stylesplat.stylize": (
                *("picture", "stroke_size", "intensity", "form", "color", "quality", "seed"),
            ),
            "stylesplat.recolor": (
                *("hue", "saturation", "brightness", "contrast", "temperature", "tint", "swap"),
            ),
            "stylesplat.mesh": ("faces", "texture_size"),
        }
        for operator, names in boxes.items():
            box = column.box().column()
            for name in names:
                box.prop(settings, name)
            box.operator(operator)
        column.operator("stylesplat.revert")


CLASSES = (StyleSplatPreferences, operators.Settings, *operators.OPERATORS, StyleSplatPanel)


def register() -> None:
    """Blender calls it when the extension is switched on."""
    for each in CLASSES:
        bpy.utils.register_class(each)
    bpy.types.Scene.stylesplat = bpy.props.PointerProperty(type=operators.Settings)


def unregister() -> None:
    """Blender calls it when the extension is switched off."""
    del bpy.types.Scene.stylesplat
    for each in reversed(CLASSES):
        bpy.utils.unregister_class(each)
