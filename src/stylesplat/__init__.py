"""StyleSplat: repaint chosen objects of a 3D Gaussian splat in the style of any picture.

Verbs over four nouns (`Capture`, `Cameras`, `Splats`, `Scene`)::

    import stylesplat as ss
    capture = ss.sfm("MyPhotos/", "garden/")         # finds the cameras; ss.load reads posed photos
    capture = ss.mask(capture, boxes={"vase": ("IMG_0007.jpg", (500, 300, 800, 700))})
    scene = ss.train(capture)                                           # Gaussians, objects
    scene = ss.select(scene, "pot", point=("IMG_0007.jpg", 640, 420))
    styled = ss.stylize(scene, {"vase": "wave.jpg", "pot": ss.Style("night.jpg", scale=2)})
    styled = ss.adjust(styled, intensity=0.7)
    ss.export(styled, "garden.ply"); ss.view(styled); ss.save(styled, "garden-wave")

Nouns are never changed: every verb takes them and returns others. Captures and scenes meet the disk
in `sfm`, `load`, `open`, `save` and `export` only.
"""

import lazy_loader

from stylesplat.runtime import tune_runtime

tune_runtime()

# Imported on first use, so that `stylesplat --help` need not wait for torch; see __init__.pyi
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
