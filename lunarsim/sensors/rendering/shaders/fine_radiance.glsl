// Radiance factor of a point (metres relative to the camera, ENU) with a unit normal, for light other
// than a point Sun. `stone` is true for rocks; `brightness` is the albedo over the terrain's mean.
#ifdef GLOW
uniform sampler2D glow;      // irradiance from terrain over the Sun's; mean I/F of that terrain
#endif

float radiance(Light light, vec3 rel, vec3 n, bool stone, float brightness) {
    float direct = reflect_sun(light, n, -normalize(rel));
#ifdef SOFT
    if (direct > 0.0) direct *= sun_share(light, rel);
#else
    if (in_shadow(light, rel)) direct = 0.0;
#endif
    float diffuse = light.surface.y;
#ifdef GLOW
    vec2 around = texture(glow, rel.xy * light.glow_from.xy + light.glow_from.zw).rg;
    // A rock's side also receives light from the terrain below.
    diffuse += BOUNCE * (around.x + (stone ? 0.5 * (1.0 - n.z) * around.y : 0.0));
#endif
#ifdef EARTH
    diffuse += light.surface.x * max(dot(n, vec3(EARTH)), 0.0);
#endif
    return brightness * (direct + diffuse);
}

#if defined(MOTTLE) || defined(ALBEDO_MAP)
#define GROUND(light, rel, n) radiance(light, rel, n, false, ground_albedo(rel))
#else
#define GROUND(light, rel, n) radiance(light, rel, n, false, 1.0)
#endif
#ifdef BOULDERS
#define STONE(light, rel, n) radiance(light, rel, n, true, brightness)
#else
#define STONE(light, rel, n) radiance(light, rel, n, true, 1.0)
#endif
