// Runs CUDA kernels on the CPU: blocks one after the other, the threads of a block as fibres that switch
// where they wait for each other. Warps have 32 lanes; a lane that is missing from a warp's exchange, or
// a thread from a barrier, ends the process with a message.
#include <setjmp.h>
#include <ucontext.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <functional>
#include <string>
#include <tuple>
#include <type_traits>

#define __global__
#define __device__
#define __forceinline__ inline
#define __noinline__ __attribute__((noinline))
#define __launch_bounds__(threads)
#define __shared__ static

struct Index {
    unsigned x, y;
};
struct float2 {
    float x, y;
};
struct alignas(16) float4 {
    float x, y, z, w;
};
static Index blockIdx, blockDim, gridDim, threadIdx;

namespace emulated {
const int MOST = 1024, STACK = 1 << 17;
struct Fibre {
    jmp_buf place;
    ucontext_t first;
    char* stack = nullptr;
    bool is_running = false;
};
struct Warp {
    int arrived, generation;
    unsigned slots[2][32];
};
static Fibre fibres[MOST];
static Warp warps[MOST / 32];
static jmp_buf outside;
static std::function<void()> body;
static int threads, alive, arrived, generation, sum, result, idle;
static int step = 1;  // -1 takes threads in the other order

static void resume(int thread) {
    threadIdx.x = thread;
    if (fibres[thread].stack) _longjmp(fibres[thread].place, 1);
    fibres[thread].stack = (char*)malloc(STACK);
    setcontext(&fibres[thread].first);
}
static int next_thread() {
    int next = threadIdx.x;
    do next = (next + step + threads) % threads;
    while (!fibres[next].is_running);
    return next;
}
static void wait() {
    if (++idle > 4 * threads * threads) {
        fprintf(stderr, "a barrier or a warp's exchange lacks a thread\n");
        abort();
    }
    int next = next_thread();
    if (next != (int)threadIdx.x && !_setjmp(fibres[threadIdx.x].place)) resume(next);
}
static void open_barrier() { result = sum, sum = arrived = idle = 0, ++generation; }
static int barrier(bool predicate) {
    int mine = generation;
    sum += predicate;
    if (++arrived == alive) open_barrier();
    while (generation == mine) wait();
    return result;
}
static const unsigned* exchange(unsigned value) {
    Warp& warp = warps[threadIdx.x / 32];
    int mine = warp.generation;
    unsigned* slots = warp.slots[mine & 1];
    slots[threadIdx.x % 32] = value;
    if (++warp.arrived == 32) warp.arrived = idle = 0, ++warp.generation;
    while (warp.generation == mine) wait();
    return slots;
}
static void run_thread() {
    for (;;) {
        body();
        fibres[threadIdx.x].is_running = false;
        if (--alive && arrived == alive) open_barrier();
        idle = 0;
        if (!_setjmp(fibres[threadIdx.x].place)) {
            if (alive == 0) _longjmp(outside, 1);
            resume(next_thread());
        }
    }
}
static void run_block() {
    arrived = sum = idle = 0, alive = threads;
    memset(warps, 0, sizeof warps);
    for (int thread = 0; thread < threads; ++thread) {
        Fibre& fibre = fibres[thread];
        fibre.is_running = true;
        if (fibre.stack) continue;
        getcontext(&fibre.first);
        fibre.first.uc_stack.ss_sp = fibre.stack = (char*)malloc(STACK);
        fibre.first.uc_stack.ss_size = STACK;
        makecontext(&fibre.first, run_thread, 0);
        fibre.stack = nullptr;  // until it runs
    }
    if (!_setjmp(outside)) resume(step > 0 ? 0 : threads - 1);
}

template <class T>
std::string code() {
    if constexpr (std::is_pointer_v<T>) return "*" + code<std::remove_const_t<std::remove_pointer_t<T>>>();
    else return std::is_same_v<T, float>       ? "f"
                : std::is_same_v<T, double>    ? "d"
                : std::is_same_v<T, int>       ? "i"
                : std::is_same_v<T, long long> ? "q"
                : std::is_same_v<T, bool>      ? "?"
                                               : "unknown";
}
template <class... Arguments>
const char* codes(void (*)(Arguments...)) {
    static const std::string found = ((code<Arguments>() + " ") + ...);
    return found.c_str();
}
template <class... Arguments>
void launch(void (*kernel)(Arguments...), const char* packed, int columns, int rows, int count) {
    size_t at = 0;
    auto take = [&](auto* type) {
        std::remove_pointer_t<decltype(type)> value;
        at = (at + alignof(decltype(value)) - 1) / alignof(decltype(value)) * alignof(decltype(value));
        memcpy(&value, packed + at, sizeof value);
        at += sizeof value;
        return value;
    };
    std::tuple<Arguments...> arguments{take((Arguments*)nullptr)...};
    body = [&] { std::apply(kernel, arguments); };
    threads = count, blockDim = {(unsigned)count, 1}, gridDim = {(unsigned)columns, (unsigned)rows};
    for (blockIdx.y = 0; blockIdx.y < gridDim.y; ++blockIdx.y)
        for (blockIdx.x = 0; blockIdx.x < gridDim.x; ++blockIdx.x) run_block();
}
}  // namespace emulated

static void __syncthreads() { emulated::barrier(false); }
static int __syncthreads_count(bool predicate) { return emulated::barrier(predicate); }
static unsigned __ballot_sync(unsigned, bool predicate) {
    const unsigned* slots = emulated::exchange(predicate);
    unsigned bits = 0;
    for (int lane = 0; lane < 32; ++lane) bits |= slots[lane] << lane;
    return bits;
}
static bool __any_sync(unsigned mask, bool predicate) { return __ballot_sync(mask, predicate) != 0; }
static bool __all_sync(unsigned mask, bool predicate) { return __ballot_sync(mask, predicate) == ~0u; }
static float __shfl_xor_sync(unsigned, float value, int bits) {
    unsigned word;
    memcpy(&word, &value, 4);
    word = emulated::exchange(word)[(threadIdx.x % 32) ^ bits];
    memcpy(&value, &word, 4);
    return value;
}
template <class T>
static T atomicAdd(T* to, T value) {
    T before = *to;
    *to += value;
    return before;
}
using std::min;
static int __ffs(unsigned bits) { return __builtin_ffs(bits); }
static unsigned __float_as_uint(float value) {
    unsigned word;
    memcpy(&word, &value, 4);
    return word;
}
#define __expf expf
