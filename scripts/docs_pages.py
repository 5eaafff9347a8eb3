"""A hook of mkdocs: pages made at build time, pages from outside docs/, and links between them.

The page of the command line is what `--help` prints, which comes from the commands' dataclasses.
The page of functions and classes lists what the package exports. Links to files that have no page
on the site, such as sources, are text there.
"""

import os
import re
from contextlib import redirect_stdout, suppress
from io import StringIO
from pathlib import Path
from posixpath import join, normpath, relpath
from typing import Any

from mkdocs.structure.files import File, Files

ROOT = Path(__file__).parents[1]
OUTSIDE = {  # files of the repository that are pages of the site
    "README.md": "index.md",
    "SECURITY.md": "security.md",
    "CHANGELOG.md": "changelog.md",
    "CODE_OF_CONDUCT.md": "conduct.md",
    "CONTRIBUTING.md": "contributing.md",
    "benchmarks/README.md": "benchmarks.md",
    "src/stylesplat/stylization/compact.md": "compact.md",
}
NOUNS = ("Capture", "Cameras", "Splats", "Scene", "Style", "Stroke", "StyleSplatError")
CONFIGS = ("training.config.TrainConfig", "stylization.config.StyleConfig")
GALLERY = ROOT / "gallery-output"  # of scripts/gallery.py
LARGEST = 4 * 2**20  # bytes of a page of the gallery that goes to the site
DEMO = ROOT / "demo-output/styled.html"  # of `make demo`: the page of docs/live.md
LIVE, NO_DEMO = "live/demo.html", "(This build of the site has no demo: run `make demo` first.)"
FRAME = re.compile(r"<iframe .*?</iframe>\n\n<a .*?</a>\.", re.DOTALL)
LINK = re.compile(r"(!?)\[((?:[^][]|\[[^]]*\])*)\]\(([^)\s]+)\)")
EXPORT = re.compile(r"^from (?:stylesplat)?\.(\S+) import (\w+) as (\w+)$", re.MULTILINE)


def on_files(files: Files, config: Any) -> Files:
    """Add the pages that do not lie in docs/."""
    pages = {page: (ROOT / path).read_text("utf-8") for path, page in OUTSIDE.items()}
    for page, text in {**pages, "cli.md": command_line(), "api.md": functions()}.items():
        files.append(File.generated(config, page, content=text))
    for name, path in gallery_pages().items():
        files.append(File.generated(config, name, abs_src_path=str(path)))
    if DEMO.is_file():
        files.append(File.generated(config, LIVE, abs_src_path=str(DEMO)))
    return files


def gallery_pages() -> dict[str, Path]:
    """The pages of painted scenes that are there and small, by their place on the site."""
    found = sorted(GALLERY.glob("*.html"))
    return {f"gallery/{path.name}": path for path in found if path.stat().st_size <= LARGEST}


def on_page_markdown(markdown: str, page: Any, config: Any, files: Files) -> str:
    """Point links of the repository to pages of the site."""
    here = page.file.src_uri
    if here == "live.md" and not DEMO.is_file():
        markdown = FRAME.sub(NO_DEMO, markdown)
    sources = {site: path for path, site in OUTSIDE.items()}
    folder = sources.get(here, f"docs/{here}").rpartition("/")[0]

    def link(match: re.Match[str]) -> str:
        picture, text, target = match.groups()
        path, hash_, anchor = target.partition("#")
        if not path or ":" in path:
            return match[0]
        page = f"{path.removesuffix('.jpg')}.html"
        if picture and page in gallery_pages():
            return f"{match[0]}\n\n[Turn it in the browser]({page})"
        path = normpath(join(folder, path))
        if path.startswith(".."):
            return ""  # of the page that hosts the repository: badges
        site = OUTSIDE.get(path, path.removeprefix("docs/"))
        if site != path:
            return (
                f"{picture}[{text}]({relpath(site, Path(here).parent.as_posix())}{hash_}{anchor})"
            )
        return text if (ROOT / path).exists() else match[0]  # what is dead stays, and is reported

    return LINK.sub(link, markdown)


def command_line() -> str:
    """What each verb's `--help` prints."""
    os.environ |= {"COLUMNS": "96", "NO_COLOR": "1"}
    from stylesplat.cli import VERBS
    from stylesplat.cli.arguments import read_arguments

    parts = [
        "# Command line\n\nWhat `stylesplat VERB --help` prints. The [manual](manual.md) says more."
    ]
    for verb in VERBS:
        with suppress(SystemExit), redirect_stdout(StringIO()) as printed:
            read_arguments(VERBS, [verb, "--help"])
        parts.append(f"## {verb}\n\n```text\n{printed.getvalue().strip()}\n```")
    return "\n\n".join(parts) + "\n"


def functions() -> str:
    """A page that mkdocstrings fills with signatures and docstrings."""
    stub = (ROOT / "src/stylesplat/__init__.pyi").read_text("utf-8")
    public = {name: f"{module}.{name}" for module, name, _ in EXPORT.findall(stub)}
    verbs = sorted(public.keys() - {*NOUNS, "stylise"})
    core = (ROOT / "src/stylesplat/functional.py").read_text("utf-8")
    groups = {
        "Nouns": [public[name] for name in NOUNS],
        "Verbs": [public[name] for name in verbs],
        "Settings": CONFIGS,
        "Functions over tensors": [f"{module}.{name}" for module, name, _ in EXPORT.findall(core)],
    }
    parts = ["# Functions and classes\n\n[In Python](python.md) shows how they go together."]
    for title, names in groups.items():
        parts.append(f"## {title}")
        parts += (f"::: stylesplat.{name}" for name in names)
    return "\n\n".join(parts) + "\n"
