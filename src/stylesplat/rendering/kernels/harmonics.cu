// Colours by spherical harmonics, with gradients of coefficients and directions. The basis is
// scene.splats's: same order, same signs.

struct Direction {
    float x, y, z, inverse;

    __device__ Direction(const float* dir) {
        inverse = 1 / fmaxf(sqrtf(dir[0] * dir[0] + dir[1] * dir[1] + dir[2] * dir[2]), 1e-12f);
        x = dir[0] * inverse, y = dir[1] * inverse, z = dir[2] * inverse;
    }
};

__device__ inline void fill_basis(const Direction& d, float (&basis)[16]) {
    float x = d.x, y = d.y, z = d.z, xx = x * x, yy = y * y, zz = z * z;
    basis[0] = SH_C0;
    basis[1] = -SH_C1 * y, basis[2] = SH_C1 * z, basis[3] = -SH_C1 * x;
    basis[4] = SH_A2 * x * y, basis[5] = -SH_A2 * y * z, basis[6] = SH_B2 * (3 * zz - 1);
    basis[7] = -SH_A2 * x * z, basis[8] = SH_C2 * (xx - yy);
    basis[9] = -SH_A3 * y * (3 * xx - yy), basis[10] = SH_B3 * x * y * z;
    basis[11] = -SH_C3 * y * (5 * zz - 1), basis[12] = SH_ZONAL * z * (5 * zz - 3);
    basis[13] = -SH_C3 * x * (5 * zz - 1), basis[14] = SH_TESSERAL * z * (xx - yy);
    basis[15] = -SH_A3 * x * (xx - 3 * yy);
}

// The gradient of a direction from that of the basis functions.
__device__ inline void store_direction_gradient(const Direction& d, const float (&s)[16], float* v_dir) {
    float x = d.x, y = d.y, z = d.z, xx = x * x, yy = y * y, zz = z * z;
    float v_x = -SH_C1 * s[3] + SH_A2 * (y * s[4] - z * s[7]) + 2 * SH_C2 * x * s[8];
    float v_y = -SH_C1 * s[1] + SH_A2 * (x * s[4] - z * s[5]) - 2 * SH_C2 * y * s[8];
    float v_z = SH_C1 * s[2] - SH_A2 * (y * s[5] + x * s[7]) + 6 * SH_B2 * z * s[6];
    v_x += -6 * SH_A3 * x * y * s[9] + SH_B3 * y * z * s[10] - SH_C3 * (5 * zz - 1) * s[13];
    v_x += 2 * SH_TESSERAL * x * z * s[14] - 3 * SH_A3 * (xx - yy) * s[15];
    v_y += -3 * SH_A3 * (xx - yy) * s[9] + SH_B3 * x * z * s[10] - SH_C3 * (5 * zz - 1) * s[11];
    v_y += -2 * SH_TESSERAL * y * z * s[14] + 6 * SH_A3 * x * y * s[15];
    v_z += SH_B3 * x * y * s[10] - 10 * SH_C3 * z * (y * s[11] + x * s[13]);
    v_z += 3 * SH_ZONAL * (5 * zz - 1) * s[12] + SH_TESSERAL * (xx - yy) * s[14];
    float radial = v_x * x + v_y * y + v_z * z;
    v_dir[0] = (v_x - radial * x) * d.inverse;
    v_dir[1] = (v_y - radial * y) * d.inverse;
    v_dir[2] = (v_z - radial * z) * d.inverse;
}

// `sh0` [N,1,3], `shN` [N,rest,3]; `bases` is 1, 4, 9 or 16, and colours are clamped at `lowest`.
extern "C" __global__ void colors(const float* dirs, const float* sh0, const float* shN, int bases,
                                  int rest, float lowest, int count, float* out) {
    int i = row_of_thread();
    if (i >= count) return;
    float basis[16];
    fill_basis(Direction(dirs + 3 * i), basis);
    const float* bands = shN + (long long)3 * rest * i;
    float sums[3];
    for (int c = 0; c < 3; ++c) sums[c] = basis[0] * sh0[3 * i + c];
#pragma unroll
    for (int k = 1; k < 16; ++k)
        if (k < bases)
            for (int c = 0; c < 3; ++c) sums[c] += basis[k] * bands[3 * k - 3 + c];
    for (int c = 0; c < 3; ++c) out[3 * i + c] = fmaxf(sums[c] + 0.5f, lowest);
}

const int MOST_BANDS = 45;  // numbers of a Gaussian

// `out` are the colours. `v_dirs` may be null. The bands go through shared memory, as threads that read
// and write rows of their own would use a fraction of each transfer.
extern "C" __global__ void colors_backward(const float* dirs, const float* shN, const float* out,
                                           const float* v_out, int bases, int rest, float lowest,
                                           int count, float* v_dirs, float* v_sh0, float* v_shN) {
    __shared__ float rows[ROWS_OF_BLOCK * MOST_BANDS];
    int i = row_of_thread(), first = blockIdx.x * blockDim.x, stride = 3 * rest;
    int size = min((int)blockDim.x, count - first) * stride;
    if (v_dirs != nullptr)
        for (int k = threadIdx.x; k < size; k += blockDim.x)
            rows[k] = shN[(long long)stride * first + k];
    __syncthreads();
    if (i < count) {
        float* bands = rows + stride * threadIdx.x;
        Direction d(dirs + 3 * i);
        float basis[16], v[3], s[16];  // s: how much each basis function counts, for the directions
        fill_basis(d, basis);
        for (int c = 0; c < 3; ++c) {
            v[c] = out[3 * i + c] > lowest ? v_out[3 * i + c] : 0;
            v_sh0[3 * i + c] = basis[0] * v[c];
        }
#pragma unroll
        for (int k = 1; k < 16; ++k) {
            s[k] = 0;
            if (k > rest) continue;
            float* band = bands + 3 * k - 3;
            if (k < bases) s[k] = band[0] * v[0] + band[1] * v[1] + band[2] * v[2];
            for (int c = 0; c < 3; ++c) band[c] = k < bases ? basis[k] * v[c] : 0;
        }
        if (v_dirs != nullptr) store_direction_gradient(d, s, v_dirs + 3 * i);
    }
    __syncthreads();
    for (int k = threadIdx.x; k < size; k += blockDim.x)
        v_shN[(long long)stride * first + k] = rows[k];
}
