"""The faces of a mesh laid flat by xatlas, in a process of its own.

xatlas holds Python's lock for many seconds, in which nothing else runs: no bar moves, and Ctrl-C
waits. The child process does not load torch.
"""

import io
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor, wait
from pathlib import Path

import numpy as np
from jaxtyping import Float, Integer

import stylesplat
from stylesplat.errors import StyleSplatError, count_noun
from stylesplat.interrupts import wait_until
from stylesplat.progress import uncounted

TEXTURE_PADDING = 4  # texels between the parts of a texture
NAMES = "origins", "faces", "uvs"


def unwrap_faces(
    vertices: Float[np.ndarray, "V 3"], faces: Integer[np.ndarray, "F 3"], size: int
) -> tuple[Integer[np.ndarray, " U"], Integer[np.ndarray, "F 3"], Float[np.ndarray, "U 2"]]:
    """Lay faces into a texture of about so many texels a side.

    Vertices lie twice where the texture has a seam. Returns the row of each among those given, the
    faces with them, and their places from 0 to 1.
    """
    given = io.BytesIO()
    np.savez(given, vertices=vertices, faces=faces.astype(np.uint32), size=size)
    place = str(Path(stylesplat.__file__).parents[1])
    code = f"import sys; sys.path.insert(0, {place!r}); import {__name__} as it; it.unwrap_stdin()"
    with uncounted("unwrapping the surface"), ThreadPoolExecutor(1) as pool:
        running = pool.submit(
            subprocess.run,
            [sys.executable, "-c", code],
            input=given.getvalue(),
            capture_output=True,
            start_new_session=True,  # Ctrl-C in the terminal is for the parent
        )
        wait_until(lambda seconds: wait([running], seconds).done)
        ended = running.result()
    if ended.returncode:
        fault = ended.stderr.decode(errors="replace").strip().rpartition("\n")[2]
        what = count_noun(len(faces), "face")
        raise StyleSplatError(
            f"Cannot unwrap {what}: xatlas ended with status {ended.returncode}. {fault}. Ask for "
            "fewer, with --faces."
        )
    found = np.load(io.BytesIO(ended.stdout))
    origins, faces, uvs = (found[name] for name in NAMES)
    return origins, faces, uvs


def unwrap_stdin() -> None:
    """The child process: unwrap what stdin has, and write the result to stdout."""
    import xatlas

    given = np.load(io.BytesIO(sys.stdin.buffer.read()))
    atlas = xatlas.Atlas()
    atlas.add_mesh(given["vertices"], given["faces"])
    charts, pack = xatlas.ChartOptions(), xatlas.PackOptions()
    charts.max_iterations = 1
    pack.resolution, pack.padding, pack.bilinear = int(given["size"]), TEXTURE_PADDING, True
    atlas.generate(charts, pack)
    np.savez(sys.stdout.buffer, **dict(zip(NAMES, atlas[0], strict=True)))
