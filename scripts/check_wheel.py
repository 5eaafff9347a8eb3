"""Build the sdist and, from it, the wheel; check both; run the demo of the wheel elsewhere.

`make wheel` calls it. What is installed comes by pip, in the versions of constraints.txt.
"""

import argparse
import os
import subprocess
import sys
import tarfile
import tempfile
import venv
from pathlib import Path, PurePosixPath
from zipfile import ZipFile

ROOT = Path(__file__).parents[1]
LIMIT = 10_000_000  # bytes of the sdist, and of the wheel
DATA_LIMIT = 8_000_000  # bytes of what is no code, unpacked
NEEDED = (
    "stylesplat/py.typed",
    "stylesplat/__init__.pyi",
    "stylesplat/demo/still_life.zip",
    "stylesplat/figures/viewer_page/page.html",
    "stylesplat/rendering/kernels/blend.cu",
    "stylesplat/rendering/kernels/common.cuh",
    "stylesplat/studio_app/page/libraries/LICENSES.txt",
    "stylesplat/stylization/compact.safetensors",
    "stylesplat/training/adam.cu",
)
VERSIONS = {  # which repeat that of pyproject.toml
    "README.md": "version = {{{}}}",
    "comfyui/pyproject.toml": '\nversion = "{}"',
    "blender/blender_manifest.toml": '\nversion = "{}"',
}
TOOLS = ("hatchling", "twine", "check-wheel-contents")
RESULTS = ("report.html", "styled.ply", "styled.html")


def run(*command: Path | str, cwd: Path | str = ROOT) -> None:
    """Run a command without anything of this environment's Python, or raise."""
    print("+", *command, flush=True)
    clean = {name: text for name, text in os.environ.items() if not name.startswith("PYTHON")}
    subprocess.run(command, cwd=cwd, env=clean, check=True)


def environment(folder: Path, packages: Path | None = None) -> Path:
    """The Python of a new virtual environment, which sees the packages of another folder last."""
    venv.create(folder, with_pip=True)
    python = folder / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    if packages is not None:
        code = "import sysconfig; print(sysconfig.get_path('purelib'))"
        own = subprocess.run([python, "-c", code], capture_output=True, text=True, check=True)
        (Path(own.stdout.strip()) / "others.pth").write_text(f"{packages.resolve()}\n")
    return python


def build(folder: Path, output: Path) -> tuple[Path, Path]:
    """The sdist, and the wheel that it gives."""
    python = environment(folder)
    pip = (python, "-m", "pip", "--disable-pip-version-check")
    run(*pip, "install", "-q", *TOOLS, "-c", ROOT / "constraints.txt")
    run(python, "-m", "hatchling", "build", "-t", "sdist", "-d", output)
    (sdist,) = output.glob("*.tar.gz")
    run(*pip, "wheel", "-q", "--no-deps", "--no-build-isolation", sdist, "-w", output)
    (wheel,) = output.glob("*.whl")
    run(python, "-m", "twine", "check", "--strict", sdist, wheel)
    run(python.with_name(f"check-wheel-contents{python.suffix}"), wheel)
    return sdist, wheel


def check_contents(sdist: Path, wheel: Path) -> None:
    """Raise an AssertionError unless they hold what they should, and no more."""
    version = wheel.name.split("-")[1]  # that of pyproject.toml
    for file, form in VERSIONS.items():
        assert form.format(version) in (ROOT / file).read_text(), f"{file}: another version"
    for path in (sdist, wheel):
        size = path.stat().st_size
        print(f"{path.name}: {size / 1e6:.1f} MB")
        assert size < LIMIT, f"{path.name} has {size} bytes, {LIMIT} at most"
    with tarfile.open(sdist) as archive:
        tops = {PurePosixPath(name).parts[1] for name in archive.getnames()}
    assert {"src", "README.md", "LICENSE", "NOTICE"} <= tops, sorted(tops)
    assert not tops & {"tests", "docs", "benchmarks"}, sorted(tops)
    with ZipFile(wheel) as archive:
        files = {each.filename: each.file_size for each in archive.infolist()}
    missing = [name for name in NEEDED if name not in files]
    assert not missing, f"the wheel lacks {missing}"
    kinds = {name.partition("/")[0].rpartition(".")[2] for name in files}
    assert kinds == {"stylesplat", "dist-info"}, f"the wheel holds {kinds}"
    assert not any("__pycache__" in name for name in files)
    code = (ROOT / "src").rglob("*.py")
    lost = {path.relative_to(ROOT / "src").as_posix() for path in code} - files.keys()
    assert not lost, f"the wheel lacks {sorted(lost)}"
    data = sum(size for name, size in files.items() if not name.endswith((".py", ".pyi")))
    print(f"data: {data / 1e6:.1f} MB unpacked")
    assert data < DATA_LIMIT, f"data of {data} bytes, {DATA_LIMIT} at most"


def try_out(wheel: Path, folder: Path, packages: Path | None) -> None:
    """Install the wheel where nothing else is, and run the demo."""
    python = environment(folder / "fresh", packages)
    options = ("--no-deps",) if packages is not None else ("-c", ROOT / "constraints.txt")
    package = f"{wheel}[photos]"  # which the demo needs
    run(python, "-m", "pip", "--disable-pip-version-check", "install", "-q", package, *options)
    place = "import stylesplat; print(stylesplat.__file__)"
    found = subprocess.run(
        [python, "-I", "-c", place], cwd=folder, capture_output=True, text=True, check=True
    ).stdout.strip()
    assert Path(found).is_relative_to(folder.resolve()), f"stylesplat comes from {found}"
    program = python.with_name("stylesplat.exe" if os.name == "nt" else "stylesplat")
    run(program, "--version", cwd=folder)
    run(program, "demo", "-o", folder / "demo", cwd=folder)
    missing = [name for name in RESULTS if not (folder / "demo" / name).exists()]
    assert not missing, f"the demo made no {missing}"


def main() -> None:
    """Build, check, install and run."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "dist")
    parser.add_argument(
        "--packages",
        type=Path,
        help="take dependencies from this site-packages instead of installing them",
    )
    arguments = parser.parse_args()
    output = arguments.output.resolve()
    output.mkdir(parents=True, exist_ok=True)
    old = [*output.glob("stylesplat-*.tar.gz"), *output.glob("stylesplat-*.whl")]
    for path in old:
        path.unlink()
    with tempfile.TemporaryDirectory(prefix="stylesplat-wheel-") as temporary:
        folder = Path(temporary).resolve()
        sdist, wheel = build(folder / "build", output)
        check_contents(sdist, wheel)
        try_out(wheel, folder, arguments.packages)
    print(f"Built and tried: {sdist.name}, {wheel.name} in {output}.", file=sys.stderr)


if __name__ == "__main__":
    main()
