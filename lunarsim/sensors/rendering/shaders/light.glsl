// Sunlight, shadows and reflection.
struct Light {
    vec3 to_sun;          // unit vector to the Sun, ENU; zero below the horizon
    vec4 across, along;   // affine transform from metres relative to the camera to shadow map texels
    vec4 drawn;           // last column and row of the map, and the size of a texel in its texture
    vec2 dark;            // depth in the map from which on a point at the camera's elevation is in
                          // shadow, and its increase per metre of height
    vec3 surface;         // albedo, I/F without the Sun, 1 for lunar-Lambert
#ifdef WIDE
    vec4 penumbra;        // as in frame.glsl
#endif
#ifdef GLOW
    vec4 glow_from;
#endif
};

uniform sampler2D shadow;    // depth of the highest face turned away from the Sun along each ray

#ifndef SOFT
bool in_shadow(Light light, vec3 rel) {
    vec2 where = vec2(dot(light.across.xyz, rel) + light.across.w,
                      dot(light.along.xyz, rel) + light.along.w);
    // The centre of the texel: the result must not depend on the size of the texture.
    where = (floor(clamp(where, vec2(1.0), light.drawn.xy)) + 0.5) * light.drawn.zw;
    float limit = light.dark.x + rel.z * light.dark.y;
    bool dark = texture(shadow, where).r < limit;
#ifdef LEAKS
    // Light leaks through ridges narrower than a texel: a point is lit only if at least three of its
    // four neighbours are.
    vec2 right = vec2(light.drawn.z, 0.0), up = vec2(0.0, light.drawn.w);
    int around = int(texture(shadow, where + right).r < limit)
               + int(texture(shadow, where - right).r < limit)
               + int(texture(shadow, where + up).r < limit)
               + int(texture(shadow, where - up).r < limit);
    dark = dark || around > 1;
#endif
    return dark;
}
#endif

// Arc cosine within 7e-5 rad: Abramowitz and Stegun (1964), 4.4.45.
float angle_of(float cosine) {
    float x = min(abs(cosine), 1.0);
    float angle = sqrt(1.0 - x) * (1.5707288 + x * (-0.2121144 + x * (0.0742610 - 0.0187293 * x)));
    return cosine < 0.0 ? 3.14159265 - angle : angle;
}

#ifndef HAPKE
// Radiance factor I/F; McEwen (1991), Icarus 92, 298-311, with his polynomial in the phase angle.
// If `surface.z` is 0, this is Lambert's law.
float reflect_sun(Light light, vec3 n, vec3 towards_camera) {
    float incidence = max(dot(n, light.to_sun), 0.0);
    float emission = max(dot(n, towards_camera), 1e-4);
    float phase = degrees(angle_of(dot(light.to_sun, towards_camera)));
    float l = clamp(1.0 + phase * (-0.019 + phase * (2.42e-4 - 1.46e-6 * phase)), 0.0, 1.0);
    l *= light.surface.z;
    return light.surface.x * incidence * (2.0 * l / (incidence + emission) + 1.0 - l);
}
#endif
