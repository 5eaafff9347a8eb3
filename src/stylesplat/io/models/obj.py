"""Wavefront OBJ with materials: their maps, and both written again with other base colours.

Lines are changed as text, so that polygons, groups, normals and what is unknown here stay. The maps
of roughness, metalness, light and normals are those of the format's extension for physically based
rendering (Pr, Pm, Ke, norm), which Blender and others write.
"""

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from PIL import Image, ImageStat

from stylesplat.errors import StyleSplatError, shorten
from stylesplat.io.files import is_file, read_bytes, resolve_within
from stylesplat.io.images import open_image
from stylesplat.progress import say

OBJ, OBJ_MATERIALS = ".obj", ".mtl"
BASE_COLOR, NORMAL_MAP, BUMPS = "map_kd", "norm", ("map_bump", "bump")
METAL, ROUGH, LIGHT = "map_pm", "map_pr", "map_ke"
NORMAL_COLOR = (128, 128, 255)  # of a surface that is not bent, in a map of normals
NEW_MATERIAL = "newmtl"
MAP_KEY = re.compile("map_[a-z]+|bump|norm|disp|decal|refl", re.IGNORECASE)
MAP_LINE = re.compile(rf"\s*({MAP_KEY.pattern})\s+(.*?)\s*$", re.IGNORECASE)
MAP_OPTION = re.compile(
    r"-(?:(?:bm|boost|texres|imfchan|type|blendu|blendv|cc|clamp)\s+\S+|mm\s+\S+\s+\S+"
    r"|[ost](?:\s+[-+.\deE]+){1,3})\s+"
)
MERGED = "materials of all libraries"  # the only library of the text for other readers
LIBRARY = re.compile(r"^[ \t]*mtllib[ \t]+([^\r\n]*)", re.MULTILINE)
OTHER_LIBRARY = re.compile(rf"{LIBRARY.pattern}\r?\n?", re.MULTILINE)
FROM_END = re.compile(r"^[ \t]*f[ \t].*-", re.MULTILINE)
COLORED_VERTEX = re.compile(r"^[ \t]*v([ \t]+\S+){6}[ \t\r]*$", re.MULTILINE)


@dataclass(frozen=True, eq=False)
class Obj:
    """An OBJ and its materials, as text."""

    path: Path
    text: str
    libraries: tuple[Path, ...]
    """Its files of materials."""
    materials: str
    """Their text, whose maps are named from the folder of the OBJ."""
    encoding: str
    """Of all these files."""

    def files(self) -> Iterator[Path]:
        """The files that it uses."""
        yield from self.libraries
        for _, _, name in self.maps():
            if (path := beside(self.path, name)) is not None:
                yield path

    def maps(self) -> Iterator[tuple[str, str, str]]:
        """The material, the kind of map in small letters and the file of each map."""
        for material, line in _by_material(self.materials):
            found = MAP_LINE.match(line)
            if found is not None:
                yield material, found[1].lower(), file_of_map(found[2])

    def can_keep(self, painted: set[str]) -> bool:
        """Whether new pictures of these materials are all that a painted one needs."""
        known = {material for material, _ in _by_material(self.materials)}
        return painted <= known and not COLORED_VERTEX.search(self.text)


def read_obj(path: Path) -> Obj:
    """An OBJ as text, with those of its materials that lie in its own folder."""
    content = read_bytes(path)
    for encoding in ("utf-8", "latin-1"):  # which takes all bytes
        try:
            text = content.decode(encoding)
            lines = [found.strip() for found in LIBRARY.findall(text)]
            libraries = tuple(library for line in lines for library in _libraries(path, line))
            materials = [_materials(path, each, encoding) for each in libraries]
        except UnicodeDecodeError:
            continue
        return Obj(path, text, libraries, "".join(materials), encoding)
    raise AssertionError


def _libraries(obj: Path, line: str) -> list[Path]:
    """The files of a line, which names several, or one that may have blanks in its name."""
    line = file_of_map(line)
    if (alone := beside(obj, line)) is not None:
        return [alone]
    words = line.split()
    names = words if any(beside(obj, each) for each in words) else [line]
    found = [file_beside(obj, each) for each in names]
    return [each for each in found if each is not None]


def _materials(obj: Path, library: Path, encoding: str) -> str:
    """The text of a library; its maps lie beside it or beside the OBJ."""
    text = read_bytes(library).decode(encoding)
    folder = library.parent.relative_to(obj.parent).as_posix()
    lines = list[str]()
    for line in text.splitlines():
        found = MAP_LINE.match(line)
        name = file_of_map(found[2]) if found else ""
        if name and folder != "." and beside(obj, f"{folder}/{name}") is not None:
            line = f"{line.rstrip()[: -len(name)]}{folder}/{name}"
        lines.append(line)
    return "".join(line + _line_end(text) for line in lines)


def text_for_readers(obj: Obj) -> str:
    """An OBJ whose only library is `MERGED`, and whose corners count from its beginning."""
    text = obj.text.replace("\r\n", "\n").replace("\\\n", "")
    if FROM_END.search(text):
        text = "\n".join(_from_beginning(text))
    return f"mtllib {MERGED}\n{text}"


def _from_beginning(text: str) -> Iterator[str]:
    """The lines, in which corners below 0 count back from where their face stands."""
    counts = {"v": 0, "vt": 0, "vn": 0}

    def absolute(index: str, key: str) -> str:
        if not index.startswith("-"):
            return index
        number = counts[key] + 1 + int(index)
        if number < 1:
            raise ValueError(f"a face counts back {index[1:]} {key}, of {counts[key]} before it")
        return str(number)

    for line in text.split("\n"):
        key, *words = line.split() or [""]
        if key in counts:
            counts[key] += 1
        if key == "f" and "-" in line:
            corners = [zip(word.split("/"), counts, strict=False) for word in words]
            yield " ".join(["f", *("/".join(absolute(*each) for each in c) for c in corners)])
        else:
            yield line


def painted_obj(
    obj: Obj, pictures: Mapping[str, str], output: Path, library: str, name_of: Callable[[str], str]
) -> tuple[bytes, bytes, dict[str, Path]]:
    """The text of an OBJ, that of its materials, and the files to copy beside it by new names.

    Args:
        obj: The OBJ before.
        pictures: The files of new base colours, beside the output, by materials.
        output: The OBJ to be made; in another folder than before it takes the other maps along.
        library: The file of its materials.
        name_of: Gives a file that is copied its name beside the output.
    """
    is_moved = output.parent.resolve() != obj.path.parent.resolve()
    copies, lines = dict[Path, str](), list[str]()

    def own(name: str) -> str:
        return name.encode().decode(obj.encoding)

    for material, line in _by_material(obj.materials):
        key = (line.split() or [""])[0].lower()
        if material in pictures and key in ("kd", BASE_COLOR):
            continue
        found = MAP_LINE.match(line)
        if is_moved and found is not None:
            name = file_of_map(found[2])
            source = beside(obj.path, name)
            if source is not None:
                if source not in copies:
                    copies[source] = name_of(name)
                line = line.rstrip()[: -len(name)] + own(copies[source])
        lines.append(line)
        if material in pictures and key == NEW_MATERIAL:
            lines += ["Kd 1 1 1", f"map_Kd {own(pictures[material])}"]
    first = LIBRARY.search(obj.text)
    assert first is not None  # its materials are from there
    rest = OTHER_LIBRARY.sub("", obj.text[first.end() :])
    text = f"{obj.text[: first.start()]}mtllib {own(library)}{rest}".encode(obj.encoding)
    materials = "".join(line + _line_end(obj.materials) for line in lines).encode(obj.encoding)
    return text, materials, {name: source for source, name in copies.items()}


def physically_based(material: Any, obj: Path) -> tuple[Any, set[str]]:
    """trimesh's material of an OBJ as one of glTF, and the kinds of its maps that are in it."""
    from trimesh.visual.material import PBRMaterial

    values: Mapping[str, Any] = material.kwargs

    def picture(kind: str) -> Image.Image | None:
        path = file_beside(obj, file_of_map(" ".join(values[kind]))) if kind in values else None
        if path is None:
            return None
        with open_image(path) as image:
            return image.convert("RGB")

    maps = {kind: picture(kind) for kind in (NORMAL_MAP, *BUMPS, METAL, ROUGH, LIGHT)}
    maps = {kind: image for kind, image in maps.items() if image is not None}
    normals = [kind for kind in (NORMAL_MAP, *BUMPS) if _is_of_normals(maps.get(kind))]
    metal, rough = maps.get(METAL), maps.get(ROUGH)
    both = None
    if sizes := [each.size for each in (rough, metal) if each is not None]:
        size = sizes[0]
        white = Image.new("L", size, 255)
        channels = [
            white if each is None else each.convert("L").resize(size) for each in (rough, metal)
        ]
        both = Image.merge("RGB", [white, *channels])
    light = [float(each) for each in values.get("ke", [])[:3]] or None
    plain, opacity = material.to_pbr(), _number(values, "d", 1.0)
    made = PBRMaterial(
        name=material.name,
        baseColorTexture=material.image,
        baseColorFactor=[*plain.baseColorFactor[:3], round(255 * opacity)],
        alphaMode="BLEND" if opacity < 1 else None,
        metallicFactor=_number(values, "pm", 0.0) if metal is None else 1.0,
        roughnessFactor=_number(values, "pr", plain.roughnessFactor) if rough is None else 1.0,
        metallicRoughnessTexture=both,
        normalTexture=maps[normals[0]] if normals else None,
        emissiveTexture=maps.get(LIGHT),
        emissiveFactor=[1.0] * 3 if LIGHT in maps else light,
    )
    return made, {BASE_COLOR, *normals[:1], *(maps.keys() & {METAL, ROUGH, LIGHT})}


def _by_material(text: str) -> Iterator[tuple[str, str]]:
    """Each line with the name of the material that it belongs to."""
    name = ""
    for line in text.splitlines():
        words = line.split()
        if words and words[0].lower() == NEW_MATERIAL:
            name = " ".join(words[1:])
        yield name, line


def is_map(key: str) -> bool:
    """Whether a key of a material is one of its maps."""
    return MAP_KEY.fullmatch(key) is not None


def file_of_map(value: str) -> str:
    """The file that a map names after its options."""
    while found := MAP_OPTION.match(value):
        value = value[found.end() :]
    return value.replace("\\", "/")


def file_beside(obj: Path, name: str) -> Path | None:
    """A file that an OBJ or its materials name; None, and a line, if it is not in their folder."""
    found = beside(obj, name)
    if found is None:
        say(f"{obj} names {shorten(name)!r}, which is not in its folder: left out.")
    return found


def beside(obj: Path, name: str) -> Path | None:
    """A file that an OBJ names, if it is in its folder."""
    try:
        path = resolve_within(obj.parent, name)
    except StyleSplatError:
        return None
    return path if is_file(path) else None


def _is_of_normals(picture: Image.Image | None) -> bool:
    """Whether a map, which may hold heights by the same key, holds normals."""
    if picture is None:
        return False
    means = ImageStat.Stat(picture).mean
    return all(abs(mean - each) < 50 for mean, each in zip(means, NORMAL_COLOR, strict=True))


def _number(values: Mapping[str, Any], key: str, default: float) -> float:
    return float(values[key][-1]) if key in values else default


def _line_end(text: str) -> str:
    return "\r\n" if "\r\n" in text else "\n"
