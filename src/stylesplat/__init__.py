"""StyleSplat: repaint chosen objects of a 3D Gaussian splat in the style of any picture.

Eight verbs over three nouns (`Capture`, `Cameras`, `Splats`)::

    import stylesplat as ss
    capture = ss.load("garden/")                 # posed photos
    capture = ss.mask(capture)                   # + one label map per photo
    splats = ss.train(capture)                   # Gaussians + identities
    picked = ss.select(splats, object_id=3)      # [N] bool
    styled = ss.stylize(splats, capture, picked, style="wave.jpg")
    ss.export(styled, "garden.ply"); ss.view(styled)
    render_colors, render_alphas, info = ss.render(styled, capture.cameras[:1])
"""

import os

# torch and numba each bring a pool of OpenMP threads. Idle threads that spin take the cores from
# the other pool: without this line a training step is two to five times slower. It must be set
# before torch is loaded.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")
