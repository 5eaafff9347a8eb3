"""Recipes on disk: YAML that a user writes, and the `recipe.json` of a styled scene."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml
from jaxtyping import Bool
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.io.files import reason
from stylesplat.scene.paintings import Painted, Painting, Source

TEXT, MERGE, FLOAT = (f"tag:yaml.org,2002:{name}" for name in ("str", "merge", "float"))


def parse_yaml(text: str | bytes) -> Any:
    """Read YAML or JSON, whose keys become texts.

    Raises:
        StyleSplatError: If it is neither.
    """
    try:
        return yaml.load(text, _Loader)
    except yaml.MarkedYAMLError as error:
        line = error.problem_mark.line + 1 if error.problem_mark else "?"
        raise StyleSplatError(f"line {line} is no valid YAML: {error.problem}.") from error
    except yaml.YAMLError as error:
        raise StyleSplatError(f"it is no YAML text: {reason(error)}.") from error


def recipe_of(painted: Painted) -> dict[str, Any]:
    """The content of `recipe.json`: what was painted, in order, and how.

    Settings that the first painting has stand once for all; each object has those that differ.
    """
    shared, last = dict(painted.paintings[0].settings), painted.paintings[-1]
    return {
        "objects": [_entry(painting, shared) for painting in painted.paintings],
        "settings": shared,
        "features": last.features,
        "weights": last.weights and last.weights.path,
        "scene": painted.origin,
    }


def paintings_in(
    content: Mapping[str, Any], rows: Sequence[Bool[Tensor, " N"]]
) -> tuple[Painting, ...]:
    """What a `recipe.json` says was painted.

    Args:
        content: Of the file.
        rows: The Gaussians of each object, in its order.

    Raises:
        StyleSplatError: If the file does not say it.
    """
    try:
        entries = zip(content["objects"], rows, strict=True)
        return tuple(_painting(entry, content, picked) for entry, picked in entries)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise StyleSplatError(f"it does not say what was painted: {reason(error)}.") from error


def listed(values: Any) -> tuple[Any, ...]:
    """What may stand alone or in a list."""
    if values is None:
        return ()
    return tuple(values) if isinstance(values, list | tuple) else (values,)


def _entry(painting: Painting, shared: Mapping[str, Any]) -> dict[str, Any]:
    weights = painting.weights
    own = {k: v for k, v in painting.settings.items() if k not in shared or v != shared[k]}
    entry = {
        "name": painting.name,
        "style": _single([source.path for source in painting.styles]),
        "sha256": _single([source.sha256 for source in painting.styles]),
        "intensity": painting.intensity,
        "settings": own,
        "features": painting.features,
        "weights": weights and weights.path,
        "weights_sha256": weights and weights.sha256,
    }
    return entry | ({"upon": dict(painting.upon)} if painting.upon else {})


def _painting(
    entry: Mapping[str, Any], content: Mapping[str, Any], picked: Bool[Tensor, " N"]
) -> Painting:
    settings = {**content["settings"], **entry["settings"]}
    paths, digests = _several(entry["style"]), _several(entry["sha256"])
    weights = entry["weights"] if "weights" in entry else content.get("weights")
    return Painting(
        name=str(entry["name"]),
        picked=picked,
        styles=tuple(
            Source(path and Path(path), digest) for path, digest in zip(paths, digests, strict=True)
        ),
        settings=settings,
        intensity=float(entry.get("intensity", settings.get("intensity", 1.0))),
        features=entry.get("features") or content["features"],
        weights=Source(Path(weights), entry.get("weights_sha256")) if weights else None,
        upon={str(name): float(value) for name, value in entry.get("upon", {}).items()},
    )


def _several(items: Any) -> list[Any]:
    """What `_single` was given."""
    return items if isinstance(items, list) else [items]


def _single(items: list[Any]) -> Any:
    """The item itself if it is the only one."""
    return items[0] if len(items) == 1 else items


class _Loader(yaml.SafeLoader):
    """YAML whose keys are unique texts, so that `3:` and `no:` are names, and all JSON."""

    def compose_mapping_node(self, anchor: Any) -> yaml.MappingNode:
        mapping = super().compose_mapping_node(anchor)
        seen = set()
        for key, _ in mapping.value:
            if not isinstance(key, yaml.ScalarNode) or key.tag == MERGE:
                continue
            key.tag = TEXT
            if key.value in seen:
                raise yaml.MarkedYAMLError(
                    problem=f"{key.value} is listed twice", problem_mark=key.start_mark
                )
            seen.add(key.value)
        return mapping

    def construct_scalar(self, node: Any) -> str:
        # JSON escapes characters beyond 16 bits as two, which YAML leaves apart
        text = super().construct_scalar(node)
        return text.encode("utf-16", "surrogatepass").decode("utf-16", "replace")


# JSON's 1e-05, which YAML 1.1 takes for text as it has no point
_Loader.add_implicit_resolver(
    FLOAT, re.compile(r"[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+$"), list("-+.0123456789")
)
