// Sunlight, shadow and reflection.
struct Light {
    vec3 to_sun;          // unit vector towards the Sun, ENU; zero where it has set
    vec4 across, along;   // from metres about the camera, and 1, to texels of the shadow map
    vec4 drawn;           // last column and row of it, and the size of a texel in its texture
    vec2 dark;            // depth in the shadow map from which on a point at the camera's level is
                          // dark, and its growth for each metre up
    vec3 surface;         // albedo, radiance factor where no Sun shines, McEwen's share
#ifdef WIDE
    vec4 penumbra;        // as in the frame
#endif
#ifdef GLOW
    vec4 glow_from;
#endif
};

uniform sampler2D shadow;    // highest lee face along each sunray

#ifndef SOFT
bool in_shadow(Light light, vec3 rel) {
    vec2 where = vec2(dot(light.across.xyz, rel) + light.across.w,
                      dot(light.along.xyz, rel) + light.along.w);
    // The middle of the texel: what is found must not depend on the size of the texture.
    where = (floor(clamp(where, vec2(1.0), light.drawn.xy)) + 0.5) * light.drawn.zw;
    float limit = light.dark.x + rel.z * light.dark.y;
    bool dark = texture(shadow, where).r < limit;
#ifdef LEAKS
    // Light leaks through where a ridge is narrower than a texel: ground counts as lit where three
    // of the four neighbours are.
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
// Without his share of the Lommel-Seeliger law, Lambert's remains.
float reflect_sun(Light light, vec3 n, vec3 towards_camera) {
    float incidence = max(dot(n, light.to_sun), 0.0);
    float emission = max(dot(n, towards_camera), 1e-4);
    float phase = degrees(angle_of(dot(light.to_sun, towards_camera)));
    float l = clamp(1.0 + phase * (-0.019 + phase * (2.42e-4 - 1.46e-6 * phase)), 0.0, 1.0);
    l *= light.surface.z;
    return light.surface.x * incidence * (2.0 * l / (incidence + emission) + 1.0 - l);
}
#endif
