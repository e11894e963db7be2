// The quadratic B-spline between equally spaced nodes.

#pragma once

#include "simd.h"

namespace warpdiff {

// Pole of the recursive filter that turns values into the coefficients of the spline through them: 2√2 − 3.
constexpr float SPLINE_POLE = -0.171572875f;

// Weights of three neighbours, a place away from the middle one.
WARPDIFF_INLINE void quadratic_spline(float away, float* weights)
{
    weights[0] = 0.5f * (0.5f - away) * (0.5f - away);
    weights[1] = 0.75f - away * away;
    weights[2] = 0.5f * (0.5f + away) * (0.5f + away);
}

} // namespace warpdiff
