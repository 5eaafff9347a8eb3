"""Fetch the libraries of the studio's page from npm: `python scripts/update_page_libraries.py`.

They are written to `src/stylesplat/studio_app/page/libraries`, with their versions and licences.
The checker of its accessibility is for tests alone, and goes to `tests/axe`.
"""

import json
import re
import shutil
import subprocess
from pathlib import Path
from tempfile import TemporaryDirectory

FOLDER = Path(__file__).parents[1] / "src/stylesplat/studio_app/page/libraries"
CHECKER = Path(__file__).parents[1] / "tests/axe"
FILES = {  # package: its module, and what the page calls it
    "preact": ("dist/preact.mjs", "preact.js"),
    "preact/hooks": ("dist/hooks.mjs", "hooks.js"),
    "@preact/signals-core": ("dist/signals-core.mjs", "signals-core.js"),
    "@preact/signals": ("dist/signals.mjs", "signals.js"),
    "htm": ("dist/htm.mjs", "htm.js"),
}
PACKAGES = [name for name in FILES if name != "preact/hooks"]


def main() -> None:
    """Install the newest versions into a temporary folder, and copy what the page needs."""
    with TemporaryDirectory() as temporary:
        subprocess.run(["npm", "install", "--prefix", temporary, *PACKAGES, "axe-core"], check=True)
        modules = Path(temporary) / "node_modules"
        FOLDER.mkdir(exist_ok=True)
        for package, (file, name) in FILES.items():
            code = (modules / package / file).read_text(encoding="utf-8")
            (FOLDER / name).write_text(with_local_imports(code), encoding="utf-8")
        licences = "\n".join(licence(modules / package) for package in PACKAGES)
        axe = modules / "axe-core"
        shutil.copy(axe / "axe.min.js", CHECKER)
        others = (axe / "LICENSE-3RD-PARTY.txt").read_text(encoding="utf-8")
        (CHECKER / "LICENSES.txt").write_text(licence(axe) + others, encoding="utf-8")
    (FOLDER / "LICENSES.txt").write_text(licences, encoding="utf-8")


def with_local_imports(code: str) -> str:
    """A module that imports its neighbours by their files, and names no source map."""
    for package, (_, name) in FILES.items():
        code = re.sub(rf'(from|import) ?"{re.escape(package)}"', rf'\1"./{name}"', code)
    return re.sub(r"\n?//# sourceMappingURL=.*", "", code) + "\n"


def licence(folder: Path) -> str:
    """The name, version and licence of a package."""
    about = json.loads((folder / "package.json").read_text(encoding="utf-8"))
    text = (folder / "LICENSE").read_text(encoding="utf-8")
    return f"{about['name']} {about['version']} ({about['license']})\n\n{text}\n"


if __name__ == "__main__":
    main()
