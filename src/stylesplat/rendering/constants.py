"""The numbers that define what a rendered image is. All are gsplat 1.5.3's."""

EPS2D = 0.3  # variance in square pixels added to every projected Gaussian: a low-pass filter
NEAR_PLANE = 0.01  # Gaussians nearer than this are not drawn
FAR_PLANE = 1e10  # nor those farther
MIN_ALPHA = 1 / 255  # fainter contributions are skipped
MAX_ALPHA = 0.999  # the clamp of version 1.5; the backward pass divides by 1 - alpha
MIN_TRANSMITTANCE = 1e-4  # a pixel is finished before it becomes darker than this
MAX_EXTENT = 3.33  # standard deviations at which a Gaussian of opacity 1 falls below MIN_ALPHA
FOV_MARGIN = 0.3  # how far outside the image, in half fields of view, the Jacobian is exact
