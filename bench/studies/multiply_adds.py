"""Peak multiply-adds of 16 floats a second of this machine, by which baselines and bounds are judged."""

from __future__ import annotations

import warp as wp

from warpdiff.kernels.compile_options import options

_MULTIPLY_ADDS = """
    typedef float lanes16 __attribute__((vector_size(64)));
    lanes16 sums[12];
    lanes16 factor, addend;
    for (int k = 0; k < 16; ++k) { factor[k] = seed; addend[k] = seed * 1e-3f; }
    for (int m = 0; m < 12; ++m) sums[m] = addend * (float)m;
    for (int i = 0; i < rounds; ++i) {
        #pragma clang loop unroll(full)
        for (int m = 0; m < 12; ++m) sums[m] = sums[m] * factor + addend;
    }
    lanes16 total = sums[0];
    for (int m = 1; m < 12; ++m) total += sums[m];
    float result = 0.0f;
    for (int k = 0; k < 16; ++k) result += total[k];
    return result;
"""
SUMS = 12


@wp.func_native(_MULTIPLY_ADDS)
def multiply_adds(seed: wp.float32, rounds: wp.int32) -> wp.float32:  # noqa: D103
    ...


@wp.kernel(module="unique", module_options=options())
def multiply_add_rate(rounds: wp.int32, first: wp.int32, sums_out: wp.array(dtype=wp.float32)):
    """Twelve independent sums of 16 floats, ``rounds`` multiply-adds each."""
    i = first + wp.tid()
    sums_out[i] = multiply_adds(0.999 + 1e-6 * wp.float32(i), rounds)
