// Resamples the spline coefficients of the lobes from the polar grid to the Cartesian grid, for one colour channel and
// four functions of w. A cubic spline interpolates over the azimuth along each of four rings. A cubic polynomial
// through the four results interpolates across the rings.

uniform highp sampler2DArray polar;  // coefficients of the polar grid's nodes, one layer per colour channel and group of four functions
uniform int layer;
uniform int ringsAnOctave;
uniform int octaves;
uniform int raysOf[MOST_OCTAVES];
uniform int startOf[MOST_OCTAVES];
uniform float ringOfLargest;
out vec4 coefficients;

const float LARGEST = 2.0, TURN = 6.283185307179586;

vec4 node(int index) {
    int width = textureSize(polar, 0).x;
    return texelFetch(polar, ivec3(index % width, index / width, layer), 0);
}

void main() {
    vec2 uv = (gl_FragCoord.xy / SIZE * 2.0 - 1.0) * LARGEST;
    float size = length(uv);
    coefficients = vec4(0.0);
    if (size > LARGEST * 1.01) return;
    float ring = clamp(log2(max(size, 1e-9) / LARGEST) * float(ringsAnOctave) + ringOfLargest, 1.0, ringOfLargest);
    float before = clamp(floor(ring), 1.0, ringOfLargest - 1.0), t = ring - before;
    vec4 ofRings = vec4(-t * (1.0 - t) * (2.0 - t) / 6.0, (1.0 + t) * (1.0 - t) * (2.0 - t) / 2.0,
        (1.0 + t) * t * (2.0 - t) / 2.0, -(1.0 + t) * t * (1.0 - t) / 6.0);
    float turns = fract(atan(uv.y, uv.x) / TURN);
    for (int along = 0; along < 4; ++along) {
        int at = int(before) - 1 + along, octave = at / ringsAnOctave, rays = raysOf[octave];
        int start = startOf[octave] + (at - octave * ringsAnOctave) * rays;
        float position = turns * float(rays), first = floor(position), s = position - first, r = 1.0 - s;
        vec4 ofRays = vec4(r * r * r / 6.0, 2.0 / 3.0 - s * s + s * s * s / 2.0, 2.0 / 3.0 - r * r + r * r * r / 2.0,
            s * s * s / 6.0);
        for (int across = 0; across < 4; ++across) {
            int ray = (int(first) - 1 + across + rays) % rays;
            coefficients += ofRings[along] * ofRays[across] * node(start + ray);
        }
    }
}
