// Which Gaussians are visible in which tiles of an image, of TILE x TILE pixels.

// Goes through the tiles of one Gaussian. Not inlined, so that counting and listing round alike.
__device__ __noinline__ long long visit_tiles(float x, float y, float a, float b, float c, float opacity,
                                              int radius_x, int radius_y, int columns, int rows, int id,
                                              unsigned depth, long long place, long long* keys,
                                              int* ids) {
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
            if (keys != nullptr) {
                keys[place] = (long long)(row * columns + column) << 32 | depth;
                ids[place] = id;
            }
            ++place;
        }
    }
    return place;
}

// Counts the tiles of each Gaussian, where `keys` is null; else lists a key for each, to sort by, and
// its Gaussian. `ends` are the running sums of the counts.
extern "C" __global__ void list_tiles(const float* means2d, const float* conics, const float* opacities,
                                      const float* depths, const int* radii, int columns, int rows,
                                      int count, int* counts, const long long* ends, long long* keys,
                                      int* ids) {
    int i = row_of_thread();
    if (i >= count) return;
    long long place = keys == nullptr ? 0 : ends[i] - counts[i];
    if (radii[2 * i] > 0)
        place = visit_tiles(means2d[2 * i], means2d[2 * i + 1], conics[3 * i], conics[3 * i + 1],
                            conics[3 * i + 2], opacities[i], radii[2 * i], radii[2 * i + 1], columns,
                            rows, i, __float_as_uint(depths[i]), place, keys, ids);
    if (keys == nullptr) counts[i] = (int)place;
}

// Cuts sorted keys into tiles: `starts` [tiles + 1]; and puts the Gaussians into their order.
extern "C" __global__ void cut_tiles(const long long* keys, const long long* sources, const int* ids,
                                     const long long* ends, int count, int tiles, long long* starts,
                                     int* order) {
    long long i = (long long)blockIdx.x * blockDim.x + threadIdx.x, pairs = ends[count - 1];
    if (i >= pairs) return;
    order[i] = ids[sources[i]];
    int own = (int)(keys[i] >> 32), before = i > 0 ? (int)(keys[i - 1] >> 32) : -1;
    for (int tile = before + 1; tile <= own; ++tile) starts[tile] = i;
    if (i == pairs - 1)
        for (int tile = own + 1; tile <= tiles; ++tile) starts[tile] = pairs;
}
