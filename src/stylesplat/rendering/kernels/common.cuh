// What all kernels share. NVRTC compiles without any header, so names are declared here. Constants in
// capitals are defined by rendering/nvrtc.py.

const unsigned WARP = 0xffffffffu;  // all lanes
const float PIXEL_CENTRE = 0.5f;

__device__ inline int row_of_thread() { return blockIdx.x * blockDim.x + threadIdx.x; }

__device__ inline float clamped(float value, float low, float high) {
    return fminf(fmaxf(value, low), high);
}

// Sums numbers over a warp. Lane l gets the sum of values[l % COUNT], COUNT a power of two: lanes
// exchange halves of what they still have, which takes COUNT shuffles and not 5 COUNT. By recursion, as
// loops would not be unrolled, and the numbers would not stay in registers.
template <int COUNT, int HALF = COUNT / 2>
__device__ __forceinline__ float warp_sums(float (&values)[COUNT], int lane) {
    if constexpr (HALF > 0) {
        bool is_upper = lane & HALF;
#pragma unroll
        for (int i = 0; i < HALF; ++i) {
            float own = is_upper ? values[i + HALF] : values[i];
            float other = is_upper ? values[i] : values[i + HALF];
            values[i] = own + __shfl_xor_sync(WARP, other, HALF);
        }
        return warp_sums<COUNT, HALF / 2>(values, lane);
    }
    float sum = values[0];
#pragma unroll
    for (int bit = COUNT; bit < 32; bit *= 2) sum += __shfl_xor_sync(WARP, sum, bit);
    return sum;
}

__device__ constexpr int power_of_two(int least) {
    return least <= 1 ? 1 : 2 * power_of_two((least + 1) / 2);
}

// The exponent of a Gaussian so far from its centre. Written with fmaf, so that all kernels round alike.
__device__ inline float exponent(float a, float b, float c, float dx, float dy) {
    return 0.5f * fmaf(fmaf(a, dx, (b + b) * dy), dx, (c * dy) * dy);
}

// Whether a Gaussian is visible in a rectangle of pixel centres, whose corners are relative to its own:
// by the least exponent there, which lies on one of the two sides that face it.
__device__ inline bool is_visible_in(float a, float b, float c, float limit, float left, float top,
                                     float right, float bottom) {
    const float endless = 1e-30f;  // one is not divided by 0
    float near_x = clamped(0, left, right), near_y = clamped(0, top, bottom);
    float best_y = clamped(-b * near_x / fmaxf(c, endless), top, bottom);
    float best_x = clamped(-b * near_y / fmaxf(a, endless), left, right);
    return fminf(exponent(a, b, c, near_x, best_y), exponent(a, b, c, best_x, near_y)) <= limit;
}

// The exponent beyond which a Gaussian is invisible, and a little more: rounding must not lose a pixel.
__device__ inline float exponent_limit(float opacity) { return logf(opacity / MIN_ALPHA) + 1e-3f; }
