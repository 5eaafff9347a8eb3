"""A reconstruction, put into a frame that people can work in."""

import numpy as np
import torch

from stylesplat.io.captures.colmap import posed_images, viewmats_of
from stylesplat.io.captures.colmap_library import pycolmap
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.frames import Frame
from stylesplat.structure_from_motion.frame import working_frame


def place(model: pycolmap.Reconstruction) -> Frame:
    """Move a reconstruction, which has no frame of its own, and return how; see `working_frame`."""
    points = [point.xyz for _, point in sorted(model.points3D.items())]
    places = torch.from_numpy(np.stack(points)).float()
    frame = working_frame(_cameras(model), places)
    shift = np.zeros(3) if frame.shift is None else frame.shift.double().numpy()
    rotation = pycolmap.Rotation3d(frame.rotation.double().numpy())
    model.transform(pycolmap.Sim3d(frame.scale, rotation, shift))
    return frame


def _cameras(model: pycolmap.Reconstruction) -> Cameras:
    """Its cameras, as pinholes."""
    images = posed_images(model)
    lenses = [model.cameras[image.camera_id] for image in images]
    return Cameras(
        viewmats=viewmats_of(images).float(),
        Ks=torch.tensor(np.stack([lens.calibration_matrix() for lens in lenses])).float(),
        sizes=torch.tensor([(lens.width, lens.height) for lens in lenses]),
        names=tuple(image.name for image in images),
    )
