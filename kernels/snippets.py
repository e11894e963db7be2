"""Pieces of native code that several kernels share, and how constants are filled into them."""

import re
from typing import Any

import warp as wp

# Sums of rows are written as sums of the compiler's own vectors, as it makes none of plain loops over registers.
CHUNKS_OF_ROWS = """
#if defined(__CUDA_ARCH__)
    typedef float chunk;
    constexpr int SIZE = 1;
#else
    constexpr int SIZE = WIDTH % 8 == 0 ? 8 : 4;
    typedef float chunk __attribute__((vector_size(SIZE * sizeof(float)), aligned(sizeof(float))));
#endif
    constexpr int CHUNKS = WIDTH / SIZE;
"""

# An index around a turn, or into an axis that repeats.
CYCLIC = """
    auto cyclic = [](int index, int count) {
        const int left = index % count;
        return left < 0 ? left + count : left;
    };
"""


def simd_batch(pixels: int) -> str:
    """How many pixels go side by side, so that the compiler makes vectors; a GPU takes one at a time."""
    return f"""
#if defined(__CUDA_ARCH__)
    constexpr int ABREAST = 1;
#else
    constexpr int ABREAST = {pixels};
#endif
"""


_TAKE_NUMBER = """
#if defined(__CUDA_ARCH__)
    return atomicAdd((int*)values.data + index, 1);
#else
    return __atomic_fetch_add((int*)values.data + index, 1, __ATOMIC_RELAXED);
#endif
"""


def filled(code: str, **numbers: Any) -> str:
    """Native code with numbers in the place of names."""
    return re.sub(rf"\b({'|'.join(numbers)})\b", lambda found: str(numbers[found[0]]), code)


# Warp's own is atomic on a GPU only, and slices of a launch run on several threads.
@wp.func_native(_TAKE_NUMBER)
def take_number(values: wp.array(dtype=wp.int32), index: wp.int32) -> wp.int32:
    """Count one up; returns what was there."""
