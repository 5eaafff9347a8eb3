// Moves means by noise along the axes of each Gaussian, more where it is faint.
extern "C" __global__ void add_noise(float* means, const float* quats, const float* scales,
                                     const float* opacities, const float* noise, float rate, int count) {
    int i = row_of_thread();
    if (i >= count || opacities[i] > DENSE_OPAQUE) return;
    float opacity = 1 / (1 + expf(-opacities[i]));
    float step = rate / (1 + expf(-NOISE_SHARPNESS * (DEAD_OPACITY - opacity)));
    float a = step * noise[3 * i] * expf(2 * scales[3 * i]);
    float b = step * noise[3 * i + 1] * expf(2 * scales[3 * i + 1]);
    float c = step * noise[3 * i + 2] * expf(2 * scales[3 * i + 2]);
    float w = quats[4 * i], x = quats[4 * i + 1], y = quats[4 * i + 2], z = quats[4 * i + 3];
    float twice = 2 / fmaxf(w * w + x * x + y * y + z * z, 1e-24f);
    // the rotation as v + 2 w (q x v) + 2 q x (q x v)
    float d = y * c - z * b, e = z * a - x * c, f = x * b - y * a;
    means[3 * i] += a + twice * (w * d + y * f - z * e);
    means[3 * i + 1] += b + twice * (w * e + z * d - x * f);
    means[3 * i + 2] += c + twice * (w * f + x * e - y * d);
}
