// Compositing tiles front to back, and the gradients of everything that goes into it.
//
// A block of threads draws a tile of TILE x TILE pixels, each warp 8 x 4 of them. Gaussians come in
// batches, as many as threads, with up to CHANNELS of their channels. What has no effect on any pixel
// of a warp is skipped by the whole warp.

#define THREADS (TILE * TILE)
#define PATCHES (THREADS / 32)
#define PATCHES_X (TILE / 8)

struct Batch {
    float4 shapes[THREADS];  // x, y, conic xx, xy
    float2 others[THREADS];  // conic yy, opacity
    int ids[THREADS];
    int patches[THREADS];  // a bit for each warp in whose pixels the Gaussian is visible
    alignas(16) float colors[THREADS][CHANNELS];
};

// Sorted Gaussians; see `TiledView` of rendering/cuda.py.
struct Tiles {
    const float *means2d, *conics, *opacities;
    const long long* starts;
    const int* order;
    int width, height;
};

// Some channels of all: rows lie `stride` floats apart.
struct Channels {
    int stride, first, count;
};

struct Pixel {
    int x, y, lane, patch;
    bool is_inside;
    long long place;

    __device__ Pixel(int width, int height) {
        lane = threadIdx.x % 32, patch = threadIdx.x / 32;
        x = blockIdx.x * TILE + patch % PATCHES_X * 8 + lane % 8;
        y = blockIdx.y * TILE + patch / PATCHES_X * 4 + lane / 8;
        is_inside = x < width && y < height;
        place = (long long)y * width + x;
    }
};

// What one Gaussian is to one pixel.
struct Contribution {
    int slot;  // in the batch
    float dx, dy;
    float alpha;   // 0 where it is too faint, or the pixel is finished
    bool is_clamped;
    float weight;  // alpha times transmittance
};

__device__ inline void load_gaussian(Batch& batch, const Tiles& tiles, long long place,
                                     const float* colors, Channels channels) {
    int slot = threadIdx.x, id = tiles.order[place];
    float x = tiles.means2d[2 * id], y = tiles.means2d[2 * id + 1];
    float a = tiles.conics[3 * id], b = tiles.conics[3 * id + 1], c = tiles.conics[3 * id + 2];
    float opacity = tiles.opacities[id], limit = exponent_limit(opacity);
    batch.shapes[slot] = {x, y, a, b};
    batch.others[slot] = {c, opacity};
    batch.ids[slot] = id;
    int patches = 0;
#pragma unroll
    for (int patch = 0; patch < PATCHES; ++patch) {
        float left = (int)blockIdx.x * TILE + patch % PATCHES_X * 8 + PIXEL_CENTRE - x;
        float top = (int)blockIdx.y * TILE + patch / PATCHES_X * 4 + PIXEL_CENTRE - y;
        if (is_visible_in(a, b, c, limit, left, top, left + 7, top + 3)) patches |= 1 << patch;
    }
    batch.patches[slot] = patches;
    if (colors == nullptr) return;
    const float* own = colors + (long long)channels.stride * id + channels.first;
#pragma unroll
    for (int channel = 0; channel < CHANNELS; ++channel)
        batch.colors[slot][channel] = channel < channels.count ? own[channel] : 0;
}

// Calls `visit`, by whole warps and front to back, with the contributions of the Gaussians that reach a
// pixel of the warp. Returns the light that is left.
template <class Visit>
__device__ inline float traverse(Batch& batch, const Tiles& tiles, const Pixel& pixel,
                                 const float* colors, Channels channels, Visit visit) {
    int tile = blockIdx.y * gridDim.x + blockIdx.x;
    long long end = tiles.starts[tile + 1];
    float light = 1, pixel_x = pixel.x + PIXEL_CENTRE, pixel_y = pixel.y + PIXEL_CENTRE;
    bool is_done = !pixel.is_inside;
    for (long long first = tiles.starts[tile]; first < end; first += THREADS) {
        if (__syncthreads_count(is_done) == THREADS) break;
        if (first + threadIdx.x < end)
            load_gaussian(batch, tiles, first + threadIdx.x, colors, channels);
        __syncthreads();
        int size = end - first < THREADS ? (int)(end - first) : THREADS;
        for (int group = 0; group < size && !__all_sync(WARP, is_done); group += 32) {
            int own = group + pixel.lane;
            bool is_near = own < size && (batch.patches[own] >> pixel.patch & 1);
            for (unsigned todo = __ballot_sync(WARP, is_near); todo != 0; todo &= todo - 1) {
                Contribution found;
                found.slot = group + __ffs(todo) - 1;
                float4 shape = batch.shapes[found.slot];
                float2 other = batch.others[found.slot];
                found.dx = pixel_x - shape.x, found.dy = pixel_y - shape.y;
                float sigma = exponent(shape.z, shape.w, other.x, found.dx, found.dy);
                float alpha = other.y * __expf(-sigma);
                found.is_clamped = alpha > MAX_ALPHA;
                alpha = fminf(alpha, MAX_ALPHA);
                found.alpha = !is_done && sigma >= 0 && alpha >= MIN_ALPHA ? alpha : 0;
                float after = light * (1 - found.alpha);
                if (!is_done && after <= MIN_TRANSMITTANCE) is_done = true, found.alpha = 0;
                if (!__any_sync(WARP, found.alpha > 0)) continue;
                found.weight = found.alpha * light;
                if (found.alpha > 0) light = after;
                visit(found);
            }
        }
    }
    return light;
}

#define TILES                                                                                   \
    const float *means2d, const float *conics, const float *opacities, const long long *starts, \
        const int *order, int width, int height
#define CHANNELS_OF int stride, int first, int count
#define BLEND_KERNEL extern "C" __global__ void __launch_bounds__(THREADS)
#define PREPARE                                                                        \
    __shared__ Batch batch;                                                            \
    const Tiles tiles = {means2d, conics, opacities, starts, order, width, height};    \
    const Channels channels = {stride, first, count};                                  \
    const Pixel pixel(width, height)

// Writes some channels of an image [H,W,stride] and, unless it is null, the coverage [H,W].
BLEND_KERNEL blend(TILES, CHANNELS_OF, const float* colors, float* image, float* alphas) {
    PREPARE;
    float sums[CHANNELS] = {};
    float light = traverse(batch, tiles, pixel, colors, channels, [&](const Contribution& found) {
#pragma unroll
        for (int channel = 0; channel < CHANNELS; ++channel)
            sums[channel] += found.weight * batch.colors[found.slot][channel];
    });
    if (!pixel.is_inside) return;
    if (alphas != nullptr) alphas[pixel.place] = 1 - light;
    float* own = image + pixel.place * stride + first;
#pragma unroll
    for (int channel = 0; channel < CHANNELS; ++channel)
        if (channel < count) own[channel] = sums[channel];
}

__device__ inline void load_pixel(float (&values)[CHANNELS], const float* image, const Pixel& pixel,
                                  Channels channels) {
#pragma unroll
    for (int channel = 0; channel < CHANNELS; ++channel)
        values[channel] = pixel.is_inside && channel < channels.count
                              ? image[pixel.place * channels.stride + channels.first + channel]
                              : 0;
}

// Adds an image, times the weights of each Gaussian, to `sums` [N,stride]: the adjoint of `blend`.
BLEND_KERNEL backproject(TILES, CHANNELS_OF, const float* image, float* sums) {
    PREPARE;
    float values[CHANNELS];
    load_pixel(values, image, pixel, channels);
    traverse(batch, tiles, pixel, nullptr, channels, [&](const Contribution& found) {
        float products[power_of_two(CHANNELS)] = {};
#pragma unroll
        for (int channel = 0; channel < CHANNELS; ++channel)
            products[channel] = found.weight * values[channel];
        float sum = warp_sums(products, pixel.lane);
        if (pixel.lane < count)
            atomicAdd(sums + (long long)stride * batch.ids[found.slot] + first + pixel.lane, sum);
    });
}

// Adds the gradients of some channels, the first `moving` of which reach the ellipses: to `v_colors`
// [N,stride] and to `v_ellipses` [N,6] (means2d, conics, opacities). `v_alphas` may be null.
BLEND_KERNEL blend_backward(TILES, CHANNELS_OF, int moving, const float* colors, const float* image,
                            const float* alphas, const float* v_image, const float* v_alphas,
                            float* v_colors, float* v_ellipses) {
    PREPARE;
    float v_pixel[CHANNELS], shown[CHANNELS];
    load_pixel(v_pixel, v_image, pixel, channels);
    load_pixel(shown, image, pixel, channels);
    float behind = 0;  // the gradient-weighted light that is still to come, or passes all
    if (v_alphas != nullptr && pixel.is_inside)
        behind = (alphas[pixel.place] - 1) * v_alphas[pixel.place];
#pragma unroll
    for (int channel = 0; channel < CHANNELS; ++channel)
        if (channel < moving) behind += v_pixel[channel] * shown[channel];
    traverse(batch, tiles, pixel, colors, channels, [&](const Contribution& found) {
        float4 shape = batch.shapes[found.slot];
        float2 other = batch.others[found.slot];
        float sums[power_of_two(6 + CHANNELS)] = {}, gain = 0;
#pragma unroll
        for (int channel = 0; channel < CHANNELS; ++channel) {
            if (channel < moving) gain += v_pixel[channel] * batch.colors[found.slot][channel];
            sums[6 + channel] = found.weight * v_pixel[channel];
        }
        gain *= found.weight;
        behind -= gain;
        float v = gain - found.alpha * behind / (1 - found.alpha);  // of the exponent's negative
        if (found.is_clamped || found.alpha == 0) v = 0;
        float dx = found.dx, dy = found.dy;
        sums[0] = v * (shape.z * dx + shape.w * dy);
        sums[1] = v * (shape.w * dx + other.x * dy);
        sums[2] = -0.5f * v * dx * dx, sums[3] = -v * dx * dy, sums[4] = -0.5f * v * dy * dy;
        sums[5] = v / other.y;
        float sum = warp_sums(sums, pixel.lane);
        long long id = batch.ids[found.slot];
        int channel = pixel.lane - 6;
        if (channel < 0) atomicAdd(v_ellipses + 6 * id + pixel.lane, sum);
        else if (channel < count) atomicAdd(v_colors + stride * id + first + channel, sum);
    });
}

#if CHANNELS == 4
// The mean depth between two shares of each pixel's weight. `planes` [N,4] has the depth at the centre,
// the slopes in x and y, and how much the weight counts; `covered` is the sum of what counts.
BLEND_KERNEL front_depth(TILES, CHANNELS_OF, const float* planes, const float* covered, float low,
                         float high, float* depths) {
    PREPARE;
    float total = pixel.is_inside ? covered[pixel.place] : 0;
    float start = total * low, stop = total * high, reached = 0, sum = 0;
    traverse(batch, tiles, pixel, planes, channels, [&](const Contribution& found) {
        const float* plane = batch.colors[found.slot];
        float before = reached;
        reached += found.weight * plane[3];
        float inside = fmaxf(fminf(reached, stop) - fmaxf(before, start), 0);
        sum += inside * (plane[0] + found.dx * plane[1] + found.dy * plane[2]);
    });
    float length = fminf(reached, stop) - start;
    if (pixel.is_inside) depths[pixel.place] = length > 0 ? sum / length : 0;
}
#endif
