"""Series of exp(2πiκh) that separate κ from the heights, and their Fourier coefficients, in NumPy; no Warp.

In: a height field, a number of terms.
Out: Fourier coefficients as functions of κ, in a fitted basis; the direct sum, which is the float64 reference.
"""
