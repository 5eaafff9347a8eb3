// Which Gaussians are visible in which tiles of an image, of TILE x TILE pixels, front to back.

// Counts a Gaussian in the tiles in which it is visible where `keys` is null; else puts its key into each
// of them, from the end. Not inlined, so that counting and listing round alike.
__device__ __noinline__ void visit_tiles(float x, float y, float a, float b, float c, float opacity,
                                         int radius_x, int radius_y, int columns, int rows,
                                         long long key, int* counts, const long long* starts,
                                         long long* keys) {
    float limit = exponent_limit(opacity);
    int first_x = (int)fmaxf(floorf((x - radius_x) / TILE), 0);
    int first_y = (int)fmaxf(floorf((y - radius_y) / TILE), 0);
    int last_x = (int)fminf(ceilf((x + radius_x) / TILE), columns);
    int last_y = (int)fminf(ceilf((y + radius_y) / TILE), rows);
    for (int row = first_y; row < last_y; ++row) {
        float top = TILE * row + PIXEL_CENTRE - y;
        for (int column = first_x; column < last_x; ++column) {
            float left = TILE * column + PIXEL_CENTRE - x;
            if (!is_visible_in(a, b, c, limit, left, top, left + (TILE - 1), top + (TILE - 1)))
                continue;
            int tile = row * columns + column;
            int rest = atomicAdd(counts + tile, keys == nullptr ? 1 : -1);
            if (keys != nullptr) keys[starts[tile] + rest - 1] = key;
        }
    }
}

// Adds the number of Gaussians to each tile's, or lists their keys: depth, then number. Listing takes the
// counts down to 0.
extern "C" __global__ void list_tiles(const float* means2d, const float* conics, const float* opacities,
                                      const float* depths, const int* radii, int columns, int rows,
                                      int count, int* counts, const long long* starts,
                                      long long* keys) {
    int i = row_of_thread();
    if (i >= count || radii[2 * i] <= 0) return;
    long long key = (long long)__float_as_uint(depths[i]) << 32 | (unsigned)i;
    visit_tiles(means2d[2 * i], means2d[2 * i + 1], conics[3 * i], conics[3 * i + 1], conics[3 * i + 2],
                opacities[i], radii[2 * i], radii[2 * i + 1], columns, rows, key, counts, starts, keys);
}

// Sorts keys by the threads of a block. Bitonic, with all comparisons in one direction: so there may be
// any number of keys, as if endless ones followed them.
__device__ __forceinline__ void sort_keys(long long* keys, unsigned size) {
    for (unsigned merged = 2; merged < 2 * size; merged *= 2) {
        for (unsigned stride = merged / 2; stride > 0; stride /= 2) {
            for (unsigned k = threadIdx.x;; k += blockDim.x) {
                unsigned low = 2 * k - (k & (stride - 1));
                if (low >= size) break;
                unsigned high = stride == merged / 2 ? low ^ (merged - 1) : low + stride;
                if (high >= size || keys[low] <= keys[high]) continue;
                long long larger = keys[low];
                keys[low] = keys[high], keys[high] = larger;
            }
            __syncthreads();
        }
    }
}

const int SORTED_AT_ONCE = 4096;  // keys: 32 KB of shared memory; of more they stay where they are

// Sorts the keys of each tile, a block for a tile, and writes the Gaussians in their order.
extern "C" __global__ void sort_tiles(const long long* starts, long long* keys, int* order) {
    __shared__ long long room[SORTED_AT_ONCE];
    long long first = starts[blockIdx.x];
    long long* own = keys + first;
    unsigned size = (unsigned)(starts[blockIdx.x + 1] - first);
    if (size <= SORTED_AT_ONCE) {
        for (unsigned k = threadIdx.x; k < size; k += blockDim.x) room[k] = own[k];
        __syncthreads();
        sort_keys(room, size);
        for (unsigned k = threadIdx.x; k < size; k += blockDim.x) order[first + k] = (int)room[k];
    } else {
        sort_keys(own, size);
        for (unsigned k = threadIdx.x; k < size; k += blockDim.x) order[first + k] = (int)own[k];
    }
}
