// Sharpens one layer of the Cartesian grid. This compensates the blur that linear interpolation between texels adds in
// look-ups; the variance of that blur is a sixth of the squared texel distance along each axis.

uniform highp sampler2D frame;
out vec4 sharpened;

vec4 at(ivec2 place) {
    return texelFetch(frame, clamp(place, ivec2(0), textureSize(frame, 0) - 1), 0);
}

void main() {
    ivec2 here = ivec2(gl_FragCoord);
    vec4 beside = at(here + ivec2(1, 0)) + at(here - ivec2(1, 0)) + at(here + ivec2(0, 1)) + at(here - ivec2(0, 1));
    sharpened = (16.0 * at(here) - beside) / 12.0;
}
