"""Runs within Blender, or in a Python that has `bpy`: every operator on a splat of each kind.

Arguments: the extension's folder, a splat's file, a picture, the program. Prints facts as JSON.
"""

import importlib
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

bpy: Any = None
splats: Any = None
FACTS: dict[str, Any] = {}


def values(thing):
    """The splat's attributes, by name."""
    kind = splats.kind_of(thing)
    names = splats.attributes_of(np.zeros((1, len(splats.COLUMNS)), np.float32), kind)
    return {n: splats.get(thing.data, n) for n in names if n in thing.data.attributes}


def activate(thing):
    for each in bpy.data.objects:
        each.select_set(False)
    thing.hide_set(False)
    thing.select_set(True)
    bpy.context.view_layer.objects.active = thing


def imported(file):
    """What Blender's importer makes: a point cloud from 5.3 on, before it a mesh."""
    bpy.ops.wm.ply_import(filepath=file, import_attributes=True)
    (thing,) = bpy.context.selected_objects
    half = splats.places(thing.data)[:, 0] < 0
    if splats.kind_of(thing) == splats.POINTS:
        thing.data.attributes.new(".selection", "BOOLEAN", "POINT").data.foreach_set("value", half)
    else:
        thing.data.vertices.foreach_set("select", half)
    assert (splats.table_of(thing)[:, :3] == splats.read_ply(Path(file))[:, :3]).all()
    return thing, half


def as_vertices(file):
    """A mesh as importers of add-ons make it."""
    table = splats.read_ply(Path(file))
    mesh = bpy.data.meshes.new("vertices")
    mesh.vertices.add(len(table))
    for name, (kind, numbers) in splats.attributes_of(table, splats.VERTICES).items():
        splats.put(mesh, name, numbers, kind)
    thing = bpy.data.objects.new("vertices", mesh)
    bpy.context.collection.objects.link(thing)
    half = table[:, 0] < 0
    mesh.vertices.foreach_set("select", half)
    return thing, half


def unchanged(before, thing, rows):
    """Whether the rows of all attributes are those before, to the bit."""
    after = values(thing)
    same = all((after[n][: len(v)][rows] == v[rows]).all() for n, v in before.items())
    return bool(same and {*before} == {*after})


def check(kind, made, picture):
    thing, half = made
    thing.matrix_world.translation = (1, 2, 3)
    bpy.context.view_layer.update()
    activate(thing)
    settings, before, facts = bpy.context.scene.stylesplat, values(thing), {}
    settings.result, settings.quality, settings.picture = "OBJECT", "draft", picture
    facts["stylize"] = bpy.ops.stylesplat.stylize() == {"FINISHED"}
    painted = bpy.context.object
    facts["new_object"] = painted != thing and painted.name.endswith("painted")
    facts["hidden"] = thing.hide_get() and thing.hide_render
    facts["kind"] = splats.kind_of(painted) == kind
    facts["original"] = unchanged(before, thing, slice(None))
    facts["rest"] = unchanged(before, painted, ~half)
    color = splats.BASE if kind == splats.POINTS else "f_dc_0"
    changed = (values(painted)[color][: len(half)] != before[color]).any(axis=1)
    facts["painted"] = float(changed[half].mean())
    facts["placed"] = [*painted.matrix_world.translation] == [1, 2, 3]
    activate(thing)
    settings.result, settings.hue, settings.swap = "LAYER", 120, "red=teal, blue=gold"
    facts["recolor"] = bpy.ops.stylesplat.recolor() == {"FINISHED"}
    facts["layer_rest"] = unchanged(before, thing, ~half)
    facts["recolored"] = bool((values(thing)[color] != before[color])[half].any())
    bpy.ops.stylesplat.revert()
    facts["reverted"] = unchanged(before, thing, slice(None))
    settings.faces, settings.texture_size = 500, "256"
    known = {*bpy.data.objects}
    facts["mesh"] = bpy.ops.stylesplat.mesh() == {"FINISHED"}
    (mesh,) = {*bpy.data.objects} - known
    bpy.context.view_layer.update()
    corners = np.array([mesh.matrix_world @ vertex.co for vertex in mesh.data.vertices])
    places = splats.places(thing.data)[half] + (1, 2, 3)
    ends = [[each.min(axis=0), each.max(axis=0)] for each in (corners, places)]
    facts["mesh_off"] = float(abs(np.array(ends[0]) - np.array(ends[1])).max())
    nodes = mesh.material_slots[0].material.node_tree.nodes
    images = [node.image for node in nodes if node.type == "TEX_IMAGE"]
    facts["texture"] = bool(images and images[0].packed_file and [*images[0].size] == [256, 256])
    FACTS[kind] = facts


def refused(operator):
    try:
        operator()
    except RuntimeError as error:  # Blender raises what an operator reports
        return str(error).strip()
    return ""


def main(folder, file, picture, path):
    global bpy, splats
    bpy = importlib.import_module("bpy")
    sys.path.insert(0, str(Path(folder).parent))
    extension: Any = importlib.import_module(Path(folder).name)
    splats = importlib.import_module(f"{Path(folder).name}.splats")
    bpy.ops.wm.read_factory_settings(use_empty=True)
    extension.register()
    extension.operators.PROGRAM = path
    FACTS["version"] = bpy.app.version_string
    for make in (as_vertices, imported):
        made = make(file)
        check(splats.kind_of(made[0]), made, picture)
        activate(made[0])
    settings = bpy.context.scene.stylesplat
    settings.picture = "no picture.jpg"
    FACTS["no_picture"] = refused(bpy.ops.stylesplat.stylize)
    settings.picture, settings.result, settings.quality = picture, "LAYER", "normal"
    extension.operators.PROGRAM = "no-such-program"
    FACTS["no_program"] = refused(bpy.ops.stylesplat.stylize)
    FACTS["no_layer"] = refused(bpy.ops.stylesplat.revert)
    extension.unregister()
    print("FACTS " + json.dumps(FACTS))


if __name__ == "__main__":
    main(*sys.argv[sys.argv.index("--") + 1 :])
