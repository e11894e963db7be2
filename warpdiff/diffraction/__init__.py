"""Series of exp(2πiκh) that separate κ from the heights, their Fourier coefficients, and the direct sum, by NumPy.

In: a height field, a number of terms.
Out: Fourier coefficients as functions of κ, in a series or a fitted basis; the direct sum in float64.
"""
