// Visible fraction of the Sun's disc.

float depth_at(Light light, vec2 texel) {
    return texture(shadow, (floor(clamp(texel, vec2(1.0), light.drawn.xy)) + 0.5) * light.drawn.zw).r;
}

float dark_at(Light light, vec2 texel, float limit) {
    return depth_at(light, texel) < limit ? 1.0 : 0.0;
}

// With a shadow edge one or two texels wide.
float plain_share(Light light, vec2 place, float limit) {
#ifdef LEAKS
    // Light leaks through ridges narrower than a texel: a point is dark if only a quarter of its
    // neighbourhood is lit.
    float dark = 0.25 * dark_at(light, place, limit);
    dark += 0.125 * (dark_at(light, place + vec2(1.0, 0.0), limit)
                     + dark_at(light, place - vec2(1.0, 0.0), limit)
                     + dark_at(light, place + vec2(0.0, 1.0), limit)
                     + dark_at(light, place - vec2(0.0, 1.0), limit));
    dark += 0.0625 * (dark_at(light, place + vec2(1.0, 1.0), limit)
                      + dark_at(light, place - vec2(1.0, 1.0), limit)
                      + dark_at(light, place + vec2(1.0, -1.0), limit)
                      + dark_at(light, place - vec2(1.0, -1.0), limit));
    return dark > 0.5 ? max(1.5 - 2.0 * dark, 0.0) : 1.0 - dark;
#else
    vec2 corner = place - 0.5;
    vec2 part = fract(corner);
    float south = mix(dark_at(light, corner, limit),
                      dark_at(light, corner + vec2(1.0, 0.0), limit), part.x);
    float north = mix(dark_at(light, corner + vec2(0.0, 1.0), limit),
                      dark_at(light, corner + vec2(1.0, 1.0), limit), part.x);
    return 1.0 - mix(south, north, part.y);
#endif
}

#ifdef WIDE
uniform sampler2D bounds;    // minimum and maximum depth of the shadow map around each of its blocks

// Sample points on a disc: for the blocker search, and for the visible fraction.
const vec2 SEARCH[SEARCHES] = vec2[](SEARCH_PLACES);
const vec2 EVEN[STRIPS * STEPS] = vec2[](EVEN_PLACES);

float sun_share(Light light, vec3 rel) {
    vec2 place = vec2(dot(light.across.xyz, rel) + light.across.w,
                      dot(light.along.xyz, rel) + light.along.w);
    float limit = light.dark.x + rel.z * light.dark.y;
    vec2 block = clamp(place, vec2(1.0), light.drawn.xy) * light.penumbra.zw;
    vec3 about = texture(bounds, block).rgb;
    if (about.r >= limit) return 1.0;
    if (about.g < limit) return 0.0;
    // Disc size for the highest occluder first; then for the mean of the occluders found.
    vec2 reach = (limit - about.b) * light.penumbra.xy;
    if (max(reach.x, reach.y) < 1.0) return plain_share(light, place, limit);
    float found = 0.0, rise = 0.0;
    for (int k = 0; k < SEARCHES; k++) {
        float over = limit - depth_at(light, place + SEARCH[k] * reach);
        found += over > 0.0 ? 1.0 : 0.0;
        rise += max(over, 0.0);
    }
    if (found == 0.0) return plain_share(light, place, limit);
    vec2 disc = rise / found * light.penumbra.xy;
    // Not finer than the map's resolution.
    disc = sqrt(disc * disc + 0.7);
    // Strips of the disc from its upper limb down: an occluder of one point hides all points below it,
    // because terrain has no overhangs. Rays to lower points may even pass below the terrain.
    float dark = 0.0;
    for (int strip = 0; strip < STRIPS; strip++) {
        float hidden = 0.0;
        for (int k = 0; k < STEPS; k++) {
            vec2 at = EVEN[strip * STEPS + k] * disc;
            hidden = max(hidden, dark_at(light, place + at, limit));
            dark += hidden;
        }
    }
    return 1.0 - dark / float(STRIPS * STEPS);
}
#else
float sun_share(Light light, vec3 rel) {
    vec2 place = vec2(dot(light.across.xyz, rel) + light.across.w,
                      dot(light.along.xyz, rel) + light.along.w);
    return plain_share(light, place, light.dark.x + rel.z * light.dark.y);
}
#endif
