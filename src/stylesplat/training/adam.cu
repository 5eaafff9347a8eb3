// A step of Adam of a tensor of rows, in place; rows that are not visible keep their value and moments.
extern "C" __global__ void adam(float* param, float* first, float* second, const float* grad,
                                const bool* visible, int rows, int columns, float rate, float scale,
                                float kept1, float kept2) {
    long long i = (long long)blockIdx.x * blockDim.x + threadIdx.x;
    if (i >= (long long)rows * columns || !visible[i / columns]) return;
    float g = grad[i];
    float m = kept1 * first[i] + (1 - kept1) * g, v = kept2 * second[i] + (1 - kept2) * g * g;
    first[i] = m, second[i] = v;
    param[i] -= rate * m / (sqrtf(v * scale) + ADAM_EPS);
}
