// Display transform, from the sum of frames in XYZ to the canvas. First, the chroma of each colour is compressed at
// constant lightness and hue of OKLab. Then ACES 2.0 is interpolated in a table, within tetrahedra. The result is mixed
// with the background in linear light. The Python module image/display_transform computes the same.

uniform highp sampler2D sum;
uniform highp sampler3D table;
uniform highp sampler2D mostChroma;
uniform float exposure, frames, white, toe;
uniform vec3 background;
uniform vec2 chromaLimits;  // relative chroma up to which colours are unchanged, and relative chroma that becomes 1
uniform mat3 xyzToCones, conesToXyz, rootsToLab, labToRoots, xyzToP3;
out vec4 shown;

vec3 signedCubeRoot(vec3 x) {
    return sign(x) * pow(abs(x), vec3(1.0 / 3.0));
}

vec3 compressChroma(vec3 xyz) {
    vec3 lab = rootsToLab * signedCubeRoot(xyzToCones * xyz);
    float chroma = length(lab.yz), hue = atan(lab.z, lab.y) / 6.283185307179586 + 0.5;
    float count = float(textureSize(mostChroma, 0).x - 1), at = hue * count, first = min(floor(at), count - 1.0);
    float below = texelFetch(mostChroma, ivec2(int(first), 0), 0).r;
    float above = texelFetch(mostChroma, ivec2(int(first) + 1, 0), 0).r;
    float ratio = chroma / max(mix(below, above, at - first) * lab.x, 1e-30);
    if (ratio <= chromaLimits.x) return xyz;
    float excess = ratio - chromaLimits.x, bend = 1.0 / (1.0 - chromaLimits.x) - 1.0 / (chromaLimits.y - chromaLimits.x);
    lab.yz *= (chromaLimits.x + excess / (1.0 + bend * excess)) / ratio;
    vec3 roots = labToRoots * lab;
    return conesToXyz * (roots * roots * roots);
}

// The three axes of the table's texture are blue, green and red, in this order.
vec3 entry(ivec3 rgb) { return texelFetch(table, rgb.bgr, 0).rgb; }
ivec3 along(int axis) { return ivec3(axis == 0, axis == 1, axis == 2); }

vec3 aces(vec3 xyz) {
    vec3 rgb = clamp(xyzToP3 * xyz, 0.0, white);
    float last = float(textureSize(table, 0).x - 1);
    vec3 place = log(1.0 + rgb / toe) / log(1.0 + white / toe) * last;
    vec3 first = min(floor(place), last - 1.0), t = place - first;
    // Tetrahedral interpolation in a cell of the table. Four corners are used: the path from the first corner to the
    // opposite one follows the axes, in the order of decreasing fractions.
    int first_ = t.r >= t.g ? (t.r >= t.b ? 0 : 2) : (t.g >= t.b ? 1 : 2);
    int last_ = t.b <= t.g ? (t.b <= t.r ? 2 : 0) : (t.g <= t.r ? 1 : 0);
    float most = max(max(t.r, t.g), t.b), least = min(min(t.r, t.g), t.b), middle = t.r + t.g + t.b - most - least;
    ivec3 corner = ivec3(first), end = corner + ivec3(1);
    ivec3 second = corner + along(first_), third = end - along(last_);
    return (1.0 - most) * entry(corner) + (most - middle) * entry(second) + (middle - least) * entry(third)
        + least * entry(end);
}

vec3 decoded(vec3 c) { return mix(c / 12.92, pow((c + 0.055) / 1.055, vec3(2.4)), greaterThan(c, vec3(0.04045))); }
vec3 encoded(vec3 c) {
    return mix(12.92 * c, 1.055 * pow(max(c, 0.0), vec3(1.0 / 2.4)) - 0.055, greaterThan(c, vec3(0.0031308)));
}

void main() {
    vec4 pixel = texelFetch(sum, ivec2(gl_FragCoord.xy), 0) / frames;
    vec3 front = vec3(0.0);
    if (pixel.a > 0.0) front = decoded(aces(compressChroma(exposure * pixel.rgb / pixel.a)));
    shown = vec4(encoded(mix(background, front, pixel.a)), 1.0);
}
