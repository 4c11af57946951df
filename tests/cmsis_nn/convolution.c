/* Runs a 3x3 convolution of CMSIS-NN once between the markers of `host/program/src/device/counter.c`, and compares its
 * result with a plain loop. `count.py` compiles it, for each combination of
 *   CHANNELS   input and output channels
 *   S16        1: features of 16 bits, 0: of 8; weights have 8 in both cases
 * Features and weights are pseudo-random; no loop of the library depends on their values. */
#include "arm_nnfunctions.h"

#define SIDE 48
#define PIXELS (SIDE * SIDE)
#if S16
typedef int16_t feature;
#define LARGEST 32767
#else
typedef int8_t feature;
#define LARGEST 127
#endif
/* The result is the sum divided by 2^SHIFT. */
#define SHIFT 8

static feature input[PIXELS * CHANNELS], output[PIXELS * CHANNELS];
static int8_t weights[CHANNELS * 9 * CHANNELS];
static int32_t bias[CHANNELS], multiplier[CHANNELS], shift[CHANNELS];
static int64_t scratch[8192];

static int semihosting(int operation, const void *argument)
{
    register int r0 __asm__("r0") = operation;
    register const void *r1 __asm__("r1") = argument;
    __asm__ volatile("bkpt 0xab" : "+r"(r0) : "r"(r1) : "memory");
    return r0;
}

static void end(const char *text)
{
    semihosting(0x04, text);
    /* ADP_Stopped_ApplicationExit. */
    semihosting(0x18, (const void *)0x20026);
    for (;;)
        ;
}

static int32_t noise(void)
{
    static uint32_t state = 1;
    state = state * 1664525u + 1013904223u;
    return (int32_t)(state >> 8);
}

/* The largest difference from the plain loop. */
static int32_t error(void)
{
    int32_t largest = 0;
    for (int r = 0; r < SIDE; r++)
        for (int c = 0; c < SIDE; c++)
            for (int o = 0; o < CHANNELS; o++) {
                int32_t sum = bias[o];
                for (int tap = 0; tap < 9; tap++) {
                    int y = r + tap / 3 - 1, x = c + tap % 3 - 1;
                    if (y < 0 || y >= SIDE || x < 0 || x >= SIDE)
                        continue;
                    for (int i = 0; i < CHANNELS; i++)
                        sum += input[(y * SIDE + x) * CHANNELS + i] * weights[(o * 9 + tap) * CHANNELS + i];
                }
                sum = (sum + (1 << (SHIFT - 1))) >> SHIFT;
                sum = sum > LARGEST ? LARGEST : sum < -LARGEST - 1 ? -LARGEST - 1 : sum;
                int32_t difference = sum - output[(r * SIDE + c) * CHANNELS + o];
                difference = difference < 0 ? -difference : difference;
                largest = difference > largest ? difference : largest;
            }
    return largest;
}

void start(void)
{
    /* CPACR: the floating-point unit and Helium. */
    *(volatile uint32_t *)0xe000ed88 |= 0xf << 20;
    __asm__ volatile("dsb\n isb");
    for (int i = 0; i < PIXELS * CHANNELS; i++)
        input[i] = (feature)noise();
    for (int i = 0; i < CHANNELS * 9 * CHANNELS; i++)
        weights[i] = (int8_t)noise();
    for (int o = 0; o < CHANNELS; o++) {
        bias[o] = noise() % 1000;
        multiplier[o] = 1 << 30;
        shift[o] = 1 - SHIFT;
    }
    cmsis_nn_conv_params convolution = {
        .stride = {1, 1}, .padding = {1, 1}, .dilation = {1, 1}, .activation = {-LARGEST - 1, LARGEST}};
    cmsis_nn_per_channel_quant_params scales = {multiplier, shift};
    cmsis_nn_dims features = {1, SIDE, SIDE, CHANNELS}, filter = {CHANNELS, 3, 3, CHANNELS};
    cmsis_nn_dims biases = {1, 1, 1, CHANNELS};
    cmsis_nn_context context = {scratch, sizeof scratch};
#if S16
    cmsis_nn_bias_data bias_data = {bias, true};
    int32_t needed = arm_convolve_wrapper_s16_get_buffer_size(&convolution, &features, &filter, &features);
#else
    const int32_t *bias_data_s8 = bias;
    int32_t needed = arm_convolve_wrapper_s8_get_buffer_size(&convolution, &features, &filter, &features);
#endif
    if (needed > (int32_t)sizeof scratch)
        end("the scratch is too small\n");
    __asm__ volatile(".hword 0xf3af, 0x80f1" ::: "memory");
#if S16
    arm_cmsis_nn_status status = arm_convolve_wrapper_s16(&context, &convolution, &scales, &features, input, &filter,
                                                          weights, &biases, &bias_data, &features, output);
#else
    arm_cmsis_nn_status status = arm_convolve_wrapper_s8(&context, &convolution, &scales, &features, input, &filter,
                                                         weights, &biases, bias_data_s8, &features, output);
#endif
    __asm__ volatile(".hword 0xf3af, 0x80f2" ::: "memory");
    if (status != ARM_CMSIS_NN_SUCCESS)
        end("CMSIS-NN refuses the shapes\n");
    end(error() <= 1 ? "right\n" : "the result differs from the plain loop\n");
}

extern char stack_end[];
__attribute__((section(".vectors"), used)) static const void *const vectors[] = {stack_end, start};
