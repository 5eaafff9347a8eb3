// Projection of Gaussians to ellipses in the image, and its gradients (EWA splatting): the mathematics
// of reference.project_gaussians, one Gaussian a thread.

struct Vec {
    float x, y, z;
};

__device__ inline Vec operator+(Vec a, Vec b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
__device__ inline Vec operator*(Vec a, Vec b) { return {a.x * b.x, a.y * b.y, a.z * b.z}; }
__device__ inline Vec operator*(Vec a, float s) { return {a.x * s, a.y * s, a.z * s}; }
__device__ inline float dot(Vec a, Vec b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
__device__ inline Vec cross(Vec a, Vec b) {
    return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}
__device__ inline Vec load(const float* from) { return {from[0], from[1], from[2]}; }
__device__ inline void store(float* to, Vec v) { to[0] = v.x, to[1] = v.y, to[2] = v.z; }

struct Rows {
    Vec x, y, z;
};

// A row vector times a matrix.
__device__ inline Vec operator*(Vec v, const Rows& m) { return m.x * v.x + m.y * v.y + m.z * v.z; }
__device__ inline Rows transposed(const Rows& m) {
    return {{m.x.x, m.y.x, m.z.x}, {m.x.y, m.y.y, m.z.y}, {m.x.z, m.y.z, m.z.z}};
}

struct Camera {
    Rows rotation;
    Vec shift;
    float fx, fy, cx, cy;

    __device__ Camera(const float* viewmat, const float* K)
        : rotation{load(viewmat), load(viewmat + 4), load(viewmat + 8)},
          shift{viewmat[3], viewmat[7], viewmat[11]},
          fx(K[0]),
          fy(K[4]),
          cx(K[2]),
          cy(K[5]) {}
};

__device__ inline float clamped_slope(float slope, float focal, float centre, int size) {
    float margin = FOV_MARGIN * 0.5f * size / focal;
    return clamped(slope, -(centre / focal + margin), (size - centre) / focal + margin);
}

// One Gaussian in one camera.
struct Projection {
    Vec p;                     // the mean in the camera
    float inverse_z;
    Vec scale;
    float w, x, y, z;          // the unit quaternion,
    float inverse_norm;        // of what was stored
    Rows rotation;
    Rows axes;                 // rows of the matrix whose columns are the scaled axes in the camera
    float slope_x, slope_y;    // at which the Jacobian is taken
    Vec a0, a1;                // the axes in pixels
    float xx, xy, yy;          // the covariance in pixels
    float sharp, det;          // its determinant, without and with the low-pass filter

    __device__ Projection(Vec mean, const float* quat, Vec scale, const Camera& camera, int width,
                          int height)
        : scale(scale) {
        p = Vec{dot(camera.rotation.x, mean), dot(camera.rotation.y, mean),
                dot(camera.rotation.z, mean)} + camera.shift;
        float squares = quat[0] * quat[0] + quat[1] * quat[1] + quat[2] * quat[2] + quat[3] * quat[3];
        inverse_norm = 1 / fmaxf(sqrtf(squares), 1e-12f);
        w = quat[0] * inverse_norm, x = quat[1] * inverse_norm;
        y = quat[2] * inverse_norm, z = quat[3] * inverse_norm;
        rotation = {{1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)},
                    {2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)},
                    {2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)}};
        axes = {camera.rotation.x * rotation * scale, camera.rotation.y * rotation * scale,
                camera.rotation.z * rotation * scale};
        inverse_z = 1 / p.z;
        slope_x = clamped_slope(p.x * inverse_z, camera.fx, camera.cx, width);
        slope_y = clamped_slope(p.y * inverse_z, camera.fy, camera.cy, height);
        a0 = axes.x * (camera.fx * inverse_z) + axes.z * (-camera.fx * slope_x * inverse_z);
        a1 = axes.y * (camera.fy * inverse_z) + axes.z * (-camera.fy * slope_y * inverse_z);
        xx = dot(a0, a0) + EPS2D, xy = dot(a0, a1), yy = dot(a1, a1) + EPS2D;
        Vec area = cross(a0, a1);  // |a0 x a1|^2 is positive where xx yy - xy xy cancels
        sharp = dot(area, area);
        det = sharp + EPS2D * (xx + yy - EPS2D);
    }

    // The factor of antialiased opacities: the root of the share of area that was there before.
    __device__ float compensation() const { return 1 / sqrtf(1 + (det - sharp) / sharp); }
};

extern "C" __global__ void project(const float* means, const float* quats, const float* scales,
                                   const float* opacities, const float* viewmat, const float* K,
                                   int width, int height, int antialiased, int count, float* means2d,
                                   float* conics, float* out_opacities, float* depths, int* radii) {
    int i = row_of_thread();
    if (i >= count) return;
    Camera camera(viewmat, K);
    Projection own(load(means + 3 * i), quats + 4 * i, load(scales + 3 * i), camera, width, height);
    float opacity = opacities[i] * (antialiased ? own.compensation() : 1.0f);
    float fade = 2 * logf(fmaxf(opacity, 1e-30f) / MIN_ALPHA);
    float extent = fminf(MAX_EXTENT, sqrtf(fmaxf(fade, 0.0f)));
    float radius_x = fminf(ceilf(extent * sqrtf(own.xx)), MAX_RADIUS);
    float radius_y = fminf(ceilf(extent * sqrtf(own.yy)), MAX_RADIUS);
    float u = camera.fx * own.p.x / own.p.z + camera.cx;
    float v = camera.fy * own.p.y / own.p.z + camera.cy;
    bool is_visible = own.p.z > NEAR_PLANE && own.p.z < FAR_PLANE && fade >= 0 && radius_x > 0 &&
                      radius_y > 0 && u > -radius_x && u < width + radius_x && v > -radius_y &&
                      v < height + radius_y;
    means2d[2 * i] = is_visible ? u : 0, means2d[2 * i + 1] = is_visible ? v : 0;
    conics[3 * i] = is_visible ? own.yy / own.det : 0;
    conics[3 * i + 1] = is_visible ? -own.xy / own.det : 0;
    conics[3 * i + 2] = is_visible ? own.xx / own.det : 0;
    depths[i] = is_visible ? own.p.z : 0;
    radii[2 * i] = is_visible ? (int)radius_x : 0, radii[2 * i + 1] = is_visible ? (int)radius_y : 0;
    if (antialiased) out_opacities[i] = is_visible ? opacity : 0;
}

// Gradient of a unit quaternion (w, then x, y, z) from that of the rows of its matrix.
__device__ inline float rotation_backward(const Projection& own, const Rows& v, Vec& v_xyz) {
    float w = own.w, x = own.x, y = own.y, z = own.z;
    v_xyz = {2 * (y * (v.x.y + v.y.x) + z * (v.x.z + v.z.x) + w * (v.z.y - v.y.z)) -
                 4 * x * (v.y.y + v.z.z),
             2 * (x * (v.x.y + v.y.x) + z * (v.y.z + v.z.y) + w * (v.x.z - v.z.x)) -
                 4 * y * (v.x.x + v.z.z),
             2 * (x * (v.x.z + v.z.x) + y * (v.y.z + v.z.y) + w * (v.y.x - v.x.y)) -
                 4 * z * (v.x.x + v.y.y)};
    return 2 * (z * (v.y.x - v.x.y) + y * (v.x.z - v.z.x) + x * (v.z.y - v.y.z));
}

// Gradients of what one camera sees; 0 of what it does not. Rows of the incoming gradients lie so many
// floats apart. Depths are not differentiated; opacities of antialiased Gaussians only. `v_view` [12]
// collects the gradient of the world-to-camera matrix in float64, as what is added cancels, or is null.
extern "C" __global__ void project_backward(
    const float* means, const float* quats, const float* scales, const float* opacities,
    const float* viewmat, const float* K, int width, int height, int antialiased, int count,
    const int* radii, const float* v_means2d, const float* v_conics, const float* v_opacities,
    int mean_stride, int conic_stride, int opacity_stride, float* v_means, float* v_quats,
    float* v_scales, float* v_own_opacities, double* v_view) {
    int i = row_of_thread();
    float view[16] = {};  // all threads take part in the sums of their warp
    if (i < count && radii[2 * i] == 0) {
        store(v_means + 3 * i, {0, 0, 0});
        store(v_quats + 4 * i, {0, 0, 0});
        v_quats[4 * i + 3] = 0;
        store(v_scales + 3 * i, {0, 0, 0});
        if (antialiased) v_own_opacities[i] = 0;
    } else if (i < count) {
        Camera camera(viewmat, K);
        Vec mean = load(means + 3 * i), scale = load(scales + 3 * i);
        Projection own(mean, quats + 4 * i, scale, camera, width, height);
        const float* v_conic = v_conics + (long long)conic_stride * i;
        const float* v_mean2d = v_means2d + (long long)mean_stride * i;
        // the covariance, through its inverse: -X V X
        float a = own.yy / own.det, b = -own.xy / own.det, c = own.xx / own.det;
        float va = v_conic[0], vb = 0.5f * v_conic[1], vc = v_conic[2];
        float xa = a * va + b * vb, xb = a * vb + b * vc, ya = b * va + c * vb, yb = b * vb + c * vc;
        float v_xx = -(xa * a + xb * b), v_xy = -(xa * b + xb * c), v_yy = -(ya * b + yb * c);
        if (antialiased) {
            float v_opacity = v_opacities[(long long)opacity_stride * i];
            float factor = own.compensation(), lost = (own.det - own.sharp) / own.det;
            v_own_opacities[i] = v_opacity * factor;
            float v_square = 0.5f * v_opacity * opacities[i] / factor, blur = EPS2D / own.det;
            v_xx += v_square * (lost * a - blur);
            v_xy += v_square * lost * b;
            v_yy += v_square * (lost * c - blur);
        }
        // the axes in pixels, then in the camera; the Jacobian
        Vec v_a0 = own.a0 * (2 * v_xx) + own.a1 * (2 * v_xy);
        Vec v_a1 = own.a0 * (2 * v_xy) + own.a1 * (2 * v_yy);
        float fx = camera.fx * own.inverse_z, fy = camera.fy * own.inverse_z;
        Rows v_axes = {v_a0 * fx, v_a1 * fy, v_a0 * (-fx * own.slope_x) + v_a1 * (-fy * own.slope_y)};
        float v_slope_x = -fx * dot(v_a0, own.axes.z), v_slope_y = -fy * dot(v_a1, own.axes.z);
        float v_z = -(fx * dot(v_a0, own.axes.x) + fy * dot(v_a1, own.axes.y)) * own.inverse_z;
        v_z -= (v_slope_x * own.slope_x + v_slope_y * own.slope_y) * own.inverse_z;
        // a clamped slope does not depend on the mean
        bool is_free_x = own.slope_x == own.p.x * own.inverse_z;
        bool is_free_y = own.slope_y == own.p.y * own.inverse_z;
        float v_x = is_free_x ? v_slope_x * own.inverse_z : 0;
        float v_y = is_free_y ? v_slope_y * own.inverse_z : 0;
        v_z -= v_x * own.slope_x + v_y * own.slope_y;
        // the mean in the image
        float v_u = fx * v_mean2d[0], v_v = fy * v_mean2d[1];
        v_z -= (v_u * own.p.x + v_v * own.p.y) * own.inverse_z;
        Vec v_p = {v_x + v_u, v_y + v_v, v_z};
        store(v_means + 3 * i, v_p * camera.rotation);
        Rows turned = transposed(camera.rotation);
        Rows e = {turned.x * v_axes, turned.y * v_axes, turned.z * v_axes};
        store(v_scales + 3 * i, e.x * own.rotation.x + e.y * own.rotation.y + e.z * own.rotation.z);
        Vec v_xyz;
        float v_w = rotation_backward(own, {e.x * scale, e.y * scale, e.z * scale}, v_xyz);
        float radial = own.w * v_w + dot({own.x, own.y, own.z}, v_xyz);
        v_quats[4 * i] = (v_w - radial * own.w) * own.inverse_norm;
        Vec rest = v_xyz + Vec{own.x, own.y, own.z} * -radial;
        store(v_quats + 4 * i + 1, rest * own.inverse_norm);
        const Vec world[3] = {own.rotation.x * scale, own.rotation.y * scale, own.rotation.z * scale};
        const float v_point[3] = {v_p.x, v_p.y, v_p.z}, point[3] = {mean.x, mean.y, mean.z};
        const Vec rows[3] = {v_axes.x, v_axes.y, v_axes.z};
#pragma unroll
        for (int row = 0; row < 3; ++row) {
#pragma unroll
            for (int k = 0; k < 3; ++k)
                view[4 * row + k] = v_point[row] * point[k] + dot(rows[row], world[k]);
            view[4 * row + 3] = v_point[row];
        }
    }
    if (v_view == nullptr) return;
    int lane = threadIdx.x % 32;
    float sum = warp_sums(view, lane);
    if (lane < 12) atomicAdd(v_view + lane, (double)sum);
}
