// What share of the Sun's disc a point sees.

float depth_at(Light light, vec2 texel) {
    return texture(shadow, (floor(clamp(texel, vec2(1.0), light.drawn.xy)) + 0.5) * light.drawn.zw).r;
}

float dark_at(Light light, vec2 texel, float limit) {
    return depth_at(light, texel) < limit ? 1.0 : 0.0;
}

// With an edge that is as wide as a texel or two.
float plain_share(Light light, vec2 place, float limit) {
#ifdef LEAKS
    // Light leaks through where a ridge is narrower than a texel: a point that but a quarter of its
    // surroundings calls lit is dark.
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
uniform sampler2D bounds;    // least depth of the shadow map about each of its blocks, and greatest

// Places on a disc: for the search, and for the share.
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
    // The disc as the highest occluder would throw it; then as those found do, on average.
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
    // No finer than the map.
    disc = sqrt(disc * disc + 0.7);
    // Strips of the disc from its upper limb down: what hides a place of it hides all below, for
    // the ground has no overhangs. Rays to lower places may well run below the ground by then.
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
