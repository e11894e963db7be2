"""Series of exp(2πiκh) that part κ from the heights, and their transforms, in NumPy; no Warp.

In: a height field, a number of terms.
Out: Fourier coefficients as functions of κ, in a basis fitted to them; the direct sum that approximates nothing.
"""
