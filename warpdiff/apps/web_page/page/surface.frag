// Shades a pixel under one light: the mean of the baked lobes over the pixel's footprint in (u, v), and the pigment.
//
// The footprint follows in closed form from the derivatives of position, normal and tangent on the face (ray
// differentials, Igehy 1999), as in kernels/footprints.py. All three are linear on a face. A GPU computes derivatives
// from four pixels of the same face, which it extends beyond its edges, so that other faces have no influence.

in vec3 vPosition, vNormal, vTangent;
flat in float vHandedness;
in vec2 vTextureUv;
in vec4 vColour;
out vec4 xyzAndCoverage;

uniform vec3 eye;
uniform vec4 place;  // homogeneous coordinates of the light: (direction, 0) or (position, 1)
uniform float power, lightDeviation, coverage, deviation, textureBias;
uniform bool smoothNormals, masking, hasShadows;
uniform float normalReflectance;
uniform mat4 lightProjection;
uniform float shadowLift;
uniform highp sampler2DShadow shadows;
uniform sampler2D baseColour;
uniform bool hasBaseColour;
uniform vec3 pigmentWhite;  // linear sRGB colour of a white pigment, divided by R(0)
uniform mat3 rgbToXyz;

uniform highp sampler2DArray lobes;
uniform highp sampler2D functionsOfW, zerothOrder;
uniform float unit;
uniform float variances[WAVELENGTHS];  // variance of the zeroth order's lobe in (u, v), per wavelength
uniform vec3 weights[WAVELENGTHS];

const float LEAST_COSINE = 0.01, LARGEST_W = 2.0, SPACING = 4.0 / SIZE;

float schlick(float cosine) {
    return normalReflectance + (1.0 - normalReflectance) * pow(1.0 - min(cosine, 1.0), 5.0);
}

// Returns the factor by which the colours of the lobes are multiplied: geometry factor, masking, and reflectance by
// Schlick's approximation relative to normal incidence.
float gain(float cosLight, float cosView, vec3 sum) {
    float least = min(cosLight, cosView);
    if (least <= 1e-6) return 0.0;
    float overlap = 0.5 * dot(sum, sum), total = cosLight + cosView, cosHalf = sqrt(0.5 * overlap);
    float mask = masking ? min(least * total * sqrt(2.0 / overlap) / cosHalf, 1.0) : 1.0;
    return schlick(cosHalf) / normalReflectance * overlap * overlap * mask / (total * total * cosView);
}

// Returns the colour of the zeroth order, a Gaussian lobe per wavelength, averaged over a footprint. `covariance` has
// the elements xx, xy and yy of the footprint's covariance in (u, v).
vec3 zeroth(vec2 uv, float w, vec3 covariance) {
    vec3 result = vec3(0.0);
    float entries = float(textureSize(zerothOrder, 0).x);
    for (int k = 0; k < WAVELENGTHS; ++k) {
        float own = variances[k], a = own + covariance.x, b = covariance.y, d = own + covariance.z;
        float determinant = a * d - b * b;
        float exponent = 0.5 * (d * uv.x * uv.x - 2.0 * b * uv.x * uv.y + a * uv.y * uv.y) / determinant;
        if (exponent > 24.0) continue;
        vec2 at = vec2(w / LARGEST_W * (entries - 1.0) + 0.5, float(k) + 0.5) / vec2(entries, WAVELENGTHS);
        float reflected = texture(zerothOrder, at).r;
        result += reflected * own * inversesqrt(determinant) * exp(-exponent) * weights[k];
    }
    return result;
}

// Returns the colour of all orders except the zeroth, averaged over a footprint. The short axis of the footprint
// selects the mip level, and several taps along the long axis are added.
vec3 others(vec2 uv, float w, vec3 covariance) {
    float middle = 0.5 * (covariance.x + covariance.z), half_ = 0.5 * (covariance.x - covariance.z);
    float root = sqrt(half_ * half_ + covariance.y * covariance.y);
    float most2 = middle + root, least2 = max(middle - root, 0.0);
    vec2 axis = abs(half_) + abs(covariance.y) < 1e-20 ? vec2(1.0, 0.0) : normalize(
        half_ > 0.0 ? vec2(half_ + root, covariance.y) : vec2(covariance.y, root - half_));
    // Mip level n blurs by a variance of (4ⁿ − 1)/4 squared texels. If the footprint is long, a coarser level is
    // selected than its short axis requires: at most TAPS taps, STEP standard deviations of the blur apart, must cover
    // the long axis.
    float own2 = 0.25 * SPACING * SPACING, blur2 = max(max(least2, most2 / (1.0 + REACH * REACH)), 1e-3 * own2);
    float level = floor(0.5 * log2(blur2 / own2 + 1.0)), scale = exp2(2.0 * level);
    float lod = level + (blur2 / own2 + 1.0 - scale) / (3.0 * scale);
    float along = sqrt(max(most2 - blur2, 0.0)), ratio = along / sqrt(blur2);
    int taps = ratio < 0.1 ? 1 : min(1 + int(ceil(2.0 * DEVIATIONS * ratio / STEP)), TAPS);
    // The weighted taps must have the variance that the long axis has in addition to the blur of the mip level. The
    // distance of the taps is scaled so that this variance is exact for any number of taps.
    float apart = taps > 1 ? 2.0 * DEVIATIONS / float(taps - 1) : 0.0, centre = 0.5 * float(taps - 1), variance = 0.0;
    float whole = 0.0;
    for (int k = 0; k < taps; ++k) {
        float away = (float(k) - centre) * apart, weight = exp(-0.5 * away * away);
        variance += weight * away * away;
        whole += weight;
    }
    vec2 per = taps > 1 ? axis * along * sqrt(whole / variance) : vec2(0.0);
    vec4 sums[LAYERS];
    for (int l = 0; l < LAYERS; ++l) sums[l] = vec4(0.0);
    for (int k = 0; k < taps; ++k) {
        float away = (float(k) - centre) * apart, weight = exp(-0.5 * away * away);
        vec2 at = (uv + per * away) / 4.0 + 0.5;
        for (int l = 0; l < LAYERS; ++l) sums[l] += weight * textureLod(lobes, vec3(at, float(l)), lod);
    }
    float entries = float(textureSize(functionsOfW, 0).x), place = (w / LARGEST_W * (entries - 1.0) + 0.5) / entries;
    vec3 result = vec3(0.0);
    for (int group = 0; group < LAYERS / 3; ++group) {
        vec4 f = texture(functionsOfW, vec2(place, (float(group) + 0.5) / float(LAYERS / 3)));
        result += vec3(dot(sums[3 * group], f), dot(sums[3 * group + 1], f), dot(sums[3 * group + 2], f));
    }
    return max(result, 0.0) * (unit * w * w / whole);
}

// Returns the derivative of the unit direction to a point, given the derivative of the surface position. `perDistance`
// is 1 divided by the distance of the point, or 0 for an infinite distance.
vec3 turns(vec3 position, vec3 direction, float perDistance) {
    return (dot(position, direction) * direction - position) * perDistance;
}

// Returns the derivative of (sum · t, sum · b), given the derivatives of position, normal and tangent. `sum` is the sum
// of the directions to light and viewer, t the tangent and b the bitangent.
vec2 changes(vec3 position, vec3 normal, vec3 tangent, mat3 frame, vec3 toView, float distance, vec3 sum, float perNormal,
             float clamped, float tilt, float perTangent, vec3 toLight, float perLight) {
    vec3 turn = turns(position, toView, 1.0 / distance) * frame, view = toView * frame;
    vec2 ofNormal = perNormal * (normal * frame).xy;
    // An interpolated normal that faces away from the viewer was turned until it has a fixed angle to the view
    // direction. Its derivative must keep this angle.
    ofNormal -= clamped * (dot(ofNormal, view.xy) + turn.z) * view.xy;
    float round_ = perTangent * (dot(tangent, frame[1]) - tilt * ofNormal.y);
    return vec2(round_ * sum.y, -round_ * sum.x) - ofNormal * sum.z + turn.xy
        + (turns(position, toLight, perLight) * frame).xy;
}

void main() {
    vec3 away = eye - vPosition, toView = normalize(away);
    vec3 geometric = normalize(cross(dFdx(vPosition), dFdy(vPosition)));
    geometric *= dot(geometric, toView) < 0.0 ? -1.0 : 1.0;
    // On back faces, the normal is reversed, so that it points to the viewer.
    float side = gl_FrontFacing ? 1.0 : -1.0, size = length(vNormal);
    bool blends = smoothNormals && size > 1e-4;
    vec3 n = blends ? vNormal * (side / size) : geometric;
    float facing = dot(n, toView);
    bool turned = facing < LEAST_COSINE;
    if (turned) {
        n = LEAST_COSINE * toView + sqrt(1.0 - LEAST_COSINE * LEAST_COSINE) * normalize(n - facing * toView);
    }
    float tilt = dot(vTangent, n), left = max(dot(vTangent, vTangent) - tilt * tilt, 1e-10);
    vec3 t = (vTangent - tilt * n) * inversesqrt(left), b = vHandedness * cross(n, t);
    mat3 frame = mat3(t, b, n);
    vec3 towards = place.xyz - place.w * vPosition;
    float near2 = dot(towards, towards), falloff = place.w > 0.0 ? 1.0 / (near2 + 1e-8) : 1.0;
    vec3 toLight = towards * inversesqrt(near2 + 1e-12);
    float perLight = place.w * inversesqrt(near2 + 1e-12);
    vec3 lightLocal = toLight * frame, sum = lightLocal + toView * frame;
    vec2 uv = -sum.xy;
    float perNormal = blends ? side / size : 0.0, clamped = turned && blends ? 1.0 : 0.0;
    vec2 right = deviation * changes(dFdx(vPosition), dFdx(vNormal), dFdx(vTangent), frame, toView, length(away), sum,
        perNormal, clamped, tilt, inversesqrt(left), toLight, perLight);
    vec2 down = deviation * changes(dFdy(vPosition), dFdy(vNormal), dFdy(vTangent), frame, toView, length(away), sum,
        perNormal, clamped, tilt, inversesqrt(left), toLight, perLight);
    float factor = power * falloff * gain(lightLocal.z, sum.z - lightLocal.z, sum);
    vec4 base = texture(baseColour, vTextureUv, textureBias);
    if (hasShadows && factor > 0.0) {
        // The position is moved away from the surface by about one texel of the shadow map before the look-up. Without
        // this, the surface would shadow itself.
        float slant = clamp(dot(geometric, toLight), 0.0, 1.0);
        vec3 from = vPosition + shadowLift * (place.w > 0.0 ? sqrt(near2) : 1.0) * (geometric * sqrt(1.0 - slant * slant) + toLight * 0.5);
        vec4 at = lightProjection * vec4(from, 1.0);
        factor *= texture(shadows, at.xyz / at.w * 0.5 + 0.5);
    }
    xyzAndCoverage = vec4(0.0, 0.0, 0.0, coverage);
    if (factor <= 0.0) return;
    vec3 covariance = vec3(right.x * right.x + down.x * down.x, right.x * right.y + down.x * down.y,
        right.y * right.y + down.y * down.y);
    // The angular size of a disc light adds variance to the footprint in the two directions perpendicular to the
    // light's direction.
    covariance += lightDeviation * lightDeviation
        * vec3(1.0 - lightLocal.x * lightLocal.x, -lightLocal.x * lightLocal.y, 1.0 - lightLocal.y * lightLocal.y);
    vec3 xyz = factor * (others(uv, sum.z, covariance) + zeroth(uv, sum.z, covariance));
    if (hasBaseColour) {
        vec3 own = vColour.a > 0.5 ? vColour.rgb : base.rgb;
        float under = (1.0 - schlick(lightLocal.z)) * (1.0 - schlick(sum.z - lightLocal.z)) * lightLocal.z;
        float lit = factor / gain(lightLocal.z, sum.z - lightLocal.z, sum);
        xyz += lit * under * (rgbToXyz * (own * pigmentWhite));
    }
    xyzAndCoverage.rgb = xyz;
}
