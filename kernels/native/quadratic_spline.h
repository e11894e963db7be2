// Quadratic B-spline on equally spaced samples.

#pragma once

#include "simd.h"

namespace warpdiff {

// Pole of the recursive filter that converts samples to coefficients of the spline through these samples. Each result
// of the filter contains the result before it, times this factor. The value was derived as 2√2 − 3.
constexpr float SPLINE_POLE = -0.171572875f;

// Compute the weights of three neighbouring coefficients of the spline, for a point at the distance `away` from the
// middle coefficient, in sample spacings.
WARPDIFF_INLINE void quadratic_spline(float away, float* weights)
{
    weights[0] = 0.5f * (0.5f - away) * (0.5f - away);
    weights[1] = 0.75f - away * away;
    weights[2] = 0.5f * (0.5f + away) * (0.5f + away);
}

} // namespace warpdiff
