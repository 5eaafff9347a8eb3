"""Reads all numbers of a USD file: run by itself, as damaged ones make OpenUSD's library crash."""

import sys
from importlib import import_module


def main(path: str) -> None:
    """Read it, if it refers to no others."""
    sdf, usd = import_module("pxr.Sdf"), import_module("pxr.Usd")
    layer = sdf.Layer.FindOrOpen(path)
    if layer is None or layer.GetCompositionAssetDependencies():
        return
    for prim in usd.Stage.Open(layer).Traverse():
        for attribute in prim.GetAttributes():
            attribute.Get(usd.TimeCode.EarliestTime())


if __name__ == "__main__":
    main(sys.argv[1])
