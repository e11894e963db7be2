"""Series of exp(2πiκh) that separate κ = w/λ from heights h, with Fourier coefficients and the direct sum, by NumPy.

In: a height field, and the number of terms of the series.
Out: Fourier coefficients as functions of κ, in a series or a fitted basis; the direct sum in float64.
"""
