// Textures of plain surfaces (surfaces without a height field) at hits: metallic and roughness, and emission. Their
// values multiply the factors of the material.
//
// A texture of roughness has the squared roughness in red, roughness in green, metallic in blue, and the product of
// roughness and metallic in alpha. The means of these channels over a footprint determine the variance of roughness,
// and its covariance with metallic.

#pragma once

#include "base_colours.h"

namespace warpdiff {

// Look-up of textures at the hits of rays, filtered by the footprint of each ray.
template <class Camera, class Surface, class Textures, class Pixels>
struct HitTextures {
    const Textures& textures;
    const int* faces;
    const float *positions, *places, *views;
    FilterSteps filter;
    float deviation, least_facing;

    WARPDIFF_INLINE HitTextures(const Camera& camera, const Surface& surface, const Textures& textures,
        const Pixels& pixels, float deviation, float least_facing)
        : textures(textures),
          faces(numbers<const int>(surface.faces)),
          positions(numbers<const float>(surface.positions)),
          places(numbers<const float>(pixels.place)),
          views(numbers<const float>(pixels.to_view)),
          filter(camera, deviation),
          deviation(deviation),
          least_facing(least_facing)
    {
    }

    // Return the colour of texture `number` at the hit of a ray on a face. `uvs` are the texture coordinates of the
    // vertices. A negative number means no texture; the colour is then white. `variance` is set to the variance of the
    // footprint [texels²], as a mean over both axes of the image.
    WARPDIFF_INLINE Rgba at(int number, const float* uvs, int ray, int face, float& variance) const
    {
        variance = 0.0f;
        if (number < 0) return {{1.0f, 1.0f, 1.0f, 1.0f}};
        const int* const corners = faces + 3LL * face;
        const float* const place = places + 2LL * ray;
        const PointUv uv(uvs, corners, place);
        if (!(deviation > 0.0f)) return sample_point(textures, number, uv);
        const UvFootprint footprint(positions, uvs, corners, place, views + 3LL * ray, filter, least_facing);
        const float* const changes = footprint.changes;
        const TextureLevel image = Texture<Textures>(textures, number).level(0);
        const float width = (float)image.width, height = (float)image.height;
        variance = 0.5f
            * (width * width * (changes[0] * changes[0] + changes[2] * changes[2])
                + height * height * (changes[1] * changes[1] + changes[3] * changes[3]));
        return sample_footprint(textures, number, uv.u, uv.v, changes);
    }
};

// Write metallic, roughness with its standard deviation, and emission of textures at the hits from `begin` to `end`.
// `deviation` is the standard deviation of each ray's filter [pixels]; if it is 0, textures are sampled at points.
template <class Camera, class Surface, class Textures, class Pixels>
WARPDIFF_INLINE void look_up_plain_textures(const Camera& camera, const Surface& surface, const Textures& textures,
    const Pixels& pixels, float deviation, float least_facing, int begin, int end)
{
    // Variance of bilinear interpolation between texels [texels²]. Interpolation smooths the roughness, so that only a
    // part of the variance between texels is a variance between points. For a footprint of the variance v, this part is
    // about v/(v + 1/4).
    constexpr float OF_INTERPOLATION = 0.25f;
    const int* const hit = numbers<const int>(pixels.hit);
    const int* const face = numbers<const int>(pixels.face);
    const float* const roughness_uvs = numbers<const float>(textures.metallic_roughness_uvs);
    const float* const emission_uvs = numbers<const float>(textures.emission_uvs);
    const HitTextures<Camera, Surface, Textures, Pixels> look_up(
        camera, surface, textures, pixels, deviation, least_facing);
    for (int ray = begin; ray < end; ++ray) {
        if (hit[ray] == 0) continue;
        const int row = numbers<const int>(textures.rows)[face[ray]];
        const int of_roughness = row < 0 ? -1 : numbers<const int>(textures.of_metallic_roughness)[row];
        const int of_emission = row < 0 ? -1 : numbers<const int>(textures.of_emission)[row];
        float variance;
        const Rgba values = look_up.at(of_roughness, roughness_uvs, ray, face[ray], variance);
        const float metallic = values.channels[2], roughness = values.channels[1];
        const float share = variance < MOST_VARIANCE ? variance / (variance + OF_INTERPOLATION) : 1.0f;
        const float spread = wp::sqrt(share * wp::max(values.channels[0] - roughness * roughness, 0.0f));
        const float covariance = share * (values.channels[3] - roughness * metallic);
        float* const metallic_roughness = numbers<float>(pixels.metallic_roughness) + 4LL * ray;
        metallic_roughness[0] = metallic;
        metallic_roughness[1] = roughness;
        metallic_roughness[2] = of_roughness < 0 ? 0.0f : spread;
        metallic_roughness[3] = of_roughness < 0 || spread <= 0.0f ? 0.0f : covariance / spread;
        const Rgba emitted = look_up.at(of_emission, emission_uvs, ray, face[ray], variance);
        float* const emission = numbers<float>(pixels.emission) + 3LL * ray;
        for (int c = 0; c < 3; ++c) emission[c] = emitted.channels[c];
    }
}

} // namespace warpdiff
