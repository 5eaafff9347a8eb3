"""What object each Gaussian of a scene belongs to, as safetensors."""

from dataclasses import replace
from pathlib import Path

import torch

from stylesplat.errors import StyleSplatError
from stylesplat.io.declared import CLASSIFIER, IDENTITIES, IDS, Declared
from stylesplat.io.tensors import read_tensors, write_tensors
from stylesplat.scene.splats import Classifier, Splats

DECLARED = {
    "identities": IDENTITIES,
    **CLASSIFIER,
    "ids": IDS,
    "confidence": Declared(("N",), low=0, high=1.001, optional=True),  # a share, and rounding
}


def write_identities(splats: Splats, path: Path) -> None:
    """Write the identities of splats and their classifier; no file if there are none.

    Raises:
        StyleSplatError: If the file cannot be written.
    """
    if splats.identities is None or splats.classifier is None:
        path.unlink(missing_ok=True)  # an earlier state's
        return
    tensors = {
        "identities": splats.identities,
        "weight": splats.classifier.weight,
        "bias": splats.classifier.bias,
        "ids": torch.tensor(splats.classifier.ids),
    }
    if splats.confidence is not None:
        tensors["confidence"] = splats.confidence
    write_tensors(tensors, path)


def with_identities(splats: Splats, path: Path) -> Splats:
    """The splats with the identities in a file, if there is one.

    Raises:
        StyleSplatError: If it is damaged, or made for other splats.
    """
    if not path.exists():
        return splats
    tensors = read_tensors(path, DECLARED, N=len(splats))
    ids = tuple(tensors.pop("ids").tolist())
    if not ids:
        raise StyleSplatError(f"Cannot read {path}: it knows no objects. Train again.")
    classifier = Classifier(tensors.pop("weight"), tensors.pop("bias"), ids)
    return replace(splats, **tensors, classifier=classifier)
