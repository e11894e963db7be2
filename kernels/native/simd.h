// Vectors of floats, rows of them, and access to Warp's arrays.
//
// A GPU takes one element at a time, so that batches and vectors are of one; the CPU's compiler makes vectors of loops
// over whole batches. Sums of rows are written with the compiler's own vectors, as it makes none of plain loops over
// registers.

#pragma once

#define WARPDIFF_INLINE CUDA_CALLABLE inline __attribute__((always_inline))

namespace warpdiff {

#if defined(__CUDA_ARCH__)
constexpr bool ON_GPU = true;
#else
constexpr bool ON_GPU = false;
#endif

// Number of elements per batch: `on_cpu` on the CPU, 1 on a GPU.
constexpr int batch_of(int on_cpu)
{
    return ON_GPU ? 1 : on_cpu;
}

// Numbers of N elements side by side. Of one element the index is known to be 0, so that it stays in a register.
template <int N, class Number = float>
struct Batch {
    Number at[N];

    WARPDIFF_INLINE Number& operator[](int i)
    {
        return at[N == 1 ? 0 : i];
    }

    WARPDIFF_INLINE const Number& operator[](int i) const
    {
        return at[N == 1 ? 0 : i];
    }
};

// FloatVector in a register, which need not lie at multiples of their size in memory.
template <int LANES>
struct FloatVector;
template <>
struct FloatVector<1> {
    typedef float type;
};
#if !defined(__CUDA_ARCH__)
template <>
struct FloatVector<4> {
    typedef float type __attribute__((vector_size(16), aligned(4)));
};
template <>
struct FloatVector<8> {
    typedef float type __attribute__((vector_size(32), aligned(4)));
};
#endif

// A row of WIDTH floats, a multiple of four, in vectors as long as that allows.
template <int WIDTH>
struct Row {
    static constexpr int LANES = ON_GPU ? 1 : WIDTH % 8 == 0 ? 8 : 4;
    static constexpr int VECTORS = WIDTH / LANES;
    typedef typename FloatVector<LANES>::type Vector;

    Vector at[VECTORS];

    WARPDIFF_INLINE void clear()
    {
        for (int l = 0; l < VECTORS; ++l) at[l] = Vector{};
    }

    WARPDIFF_INLINE void add(float factor, const float* row)
    {
#pragma unroll
        for (int l = 0; l < VECTORS; ++l) at[l] += factor * ((const Vector*)row)[l];
    }

    WARPDIFF_INLINE void add(float factor, const Row& row)
    {
        for (int l = 0; l < VECTORS; ++l) at[l] += factor * row.at[l];
    }
};

// A sum of rows so far, and of their weights.
template <int WIDTH>
struct WeighedRows {
    Row<WIDTH> rows;
    float weights;

    WARPDIFF_INLINE void clear()
    {
        rows.clear();
        weights = 0.0f;
    }
};

// The numbers of a Warp array, whose elements may be vectors of them.
template <class Number, class Array>
WARPDIFF_INLINE Number* numbers(const Array& array)
{
    return (Number*)array.data;
}

template <class Array>
WARPDIFF_INLINE bool is_empty(const Array& array)
{
    return array.shape[0] == 0;
}

// An index modulo the length of a periodic axis.
WARPDIFF_INLINE int cyclic(int index, int count)
{
    const int left = index % count;
    return left < 0 ? left + count : left;
}

// Prefetch what is read soon. A GPU runs other threads instead while one waits.
WARPDIFF_INLINE void prefetch(const float* at)
{
#if !defined(__CUDA_ARCH__)
    __builtin_prefetch(at);
#else
    (void)at;
#endif
}

} // namespace warpdiff
