// Textures of plain surfaces at hits: metallic and roughness, and emission. They multiply the factors of the material.

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

    // Return the colour of a texture at the hit of a ray on a face, at the texture coordinates `uvs` of the vertices. A
    // negative number is no texture, which is white.
    WARPDIFF_INLINE Rgba at(int number, const float* uvs, int ray, int face) const
    {
        if (number < 0) return {{1.0f, 1.0f, 1.0f, 1.0f}};
        const int* const corners = faces + 3LL * face;
        const float* const place = places + 2LL * ray;
        const PointUv uv(uvs, corners, place);
        if (!(deviation > 0.0f)) return sample_point(textures, number, uv);
        const UvFootprint footprint(positions, uvs, corners, place, views + 3LL * ray, filter, least_facing);
        return sample_footprint(textures, number, uv.u, uv.v, footprint.changes);
    }
};

// Write metallic (blue), roughness (green) and emission of textures at the hits from `begin` to `end`.
// `deviation` is the standard deviation of the rays' filter [pixels]; without one, textures are sampled at points.
template <class Camera, class Surface, class Textures, class Pixels>
WARPDIFF_INLINE void look_up_plain_textures(const Camera& camera, const Surface& surface, const Textures& textures,
    const Pixels& pixels, float deviation, float least_facing, int begin, int end)
{
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
        const Rgba values = look_up.at(of_roughness, roughness_uvs, ray, face[ray]);
        float* const metallic_roughness = numbers<float>(pixels.metallic_roughness) + 2LL * ray;
        metallic_roughness[0] = values.channels[2];
        metallic_roughness[1] = values.channels[1];
        const Rgba emitted = look_up.at(of_emission, emission_uvs, ray, face[ray]);
        float* const emission = numbers<float>(pixels.emission) + 3LL * ray;
        for (int c = 0; c < 3; ++c) emission[c] = emitted.channels[c];
    }
}

} // namespace warpdiff
