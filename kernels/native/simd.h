// SIMD vectors of floats, rows of these vectors, and access to Warp's arrays.
//
// On a GPU, batches and vectors have one element. On the CPU, compilers vectorise loops over whole batches. Sums of
// rows use vector types of the compiler explicitly: with plain loops, compilers would not keep the sums in vector
// registers.

#pragma once

#define WARPDIFF_INLINE CUDA_CALLABLE inline __attribute__((always_inline))

namespace warpdiff {

#if defined(__CUDA_ARCH__)
constexpr bool ON_GPU = true;
#else
constexpr bool ON_GPU = false;
#endif

// Number of elements that loops process together (a batch): `on_cpu` on the CPU, 1 on a GPU.
constexpr int batch_of(int on_cpu)
{
    return ON_GPU ? 1 : on_cpu;
}

// A batch of N values. With N = 1 all indices are replaced by the constant 0, so that the value can remain in a
// register.
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

// Vector of LANES floats. In memory it needs only the alignment of a single float.
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

// A table row of WIDTH floats, stored as the longest vectors into which the row can be divided. On the CPU, WIDTH is a
// multiple of four.
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

// A weighted sum of rows of a colour table, and the sum of the weights.
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

// Return a pointer to the first number of a Warp array. The elements of the array may be numbers or vectors.
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

// Return an index modulo the length of a periodic axis. The result is never negative.
WARPDIFF_INLINE int cyclic(int index, int count)
{
    const int left = index % count;
    return left < 0 ? left + count : left;
}

// Begin to fetch data that is used soon from memory into the cache. On a GPU the function does nothing: the GPU runs
// other threads while one thread waits for memory.
WARPDIFF_INLINE void prefetch(const float* at)
{
#if !defined(__CUDA_ARCH__)
    __builtin_prefetch(at);
#else
    (void)at;
#endif
}

} // namespace warpdiff
