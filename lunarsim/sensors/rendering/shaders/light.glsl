// Sunlight, shadow and reflection.
uniform vec3 sun;            // unit vector towards the Sun, ENU
uniform int shaded;          // whether there is a shadow map
uniform int patched;         // whether relief at several levels of detail is in it
uniform sampler2D shadow;    // highest lee face along each sunray, see shadow.glsl
uniform vec2 map_size;       // texels
uniform vec2 heights;        // highest and lowest elevation of the shadow map, m above the camera
uniform float albedo;        // of the surface
uniform float ambient;       // radiance factor of an unlit surface over the albedo
uniform int lunar_lambert;   // 0 Lambert, 1 McEwen's lunar-Lambert
uniform float slack;         // elevation of an occluder over a point from which on it shades it, m

bool in_shadow(vec3 rel) {
    vec2 where = clamp(shadow_place(rel) * map_size, vec2(1.0), map_size - 2.0);
    ivec2 at = ivec2(where);
    float limit = (heights.x - rel.z - slack) / (heights.x - heights.y);
    if (texelFetch(shadow, at, 0).r < limit) return true;
    if (patched == 0) return false;
    // Tiles at different levels of detail leave cracks a texel wide, through which light would
    // leak: ground counts as lit where three of the four neighbours are.
    int dark = int(texelFetch(shadow, at + ivec2(1, 0), 0).r < limit)
             + int(texelFetch(shadow, at - ivec2(1, 0), 0).r < limit)
             + int(texelFetch(shadow, at + ivec2(0, 1), 0).r < limit)
             + int(texelFetch(shadow, at - ivec2(0, 1), 0).r < limit);
    return dark > 1;
}

// Arc cosine within 7e-5 rad: Abramowitz and Stegun (1964), 4.4.45.
float angle_of(float cosine) {
    float x = min(abs(cosine), 1.0);
    float angle = sqrt(1.0 - x) * (1.5707288 + x * (-0.2121144 + x * (0.0742610 - 0.0187293 * x)));
    return cosine < 0.0 ? 3.14159265 - angle : angle;
}

// Radiance factor I/F; McEwen (1991), Icarus 92, 298-311, with his polynomial in the phase angle.
float reflect_sun(vec3 n, vec3 towards_camera) {
    float incidence = dot(n, sun);
    if (incidence <= 0.0) return 0.0;
    if (lunar_lambert == 0) return albedo * incidence;
    float emission = max(dot(n, towards_camera), 1e-4);
    float phase = degrees(angle_of(dot(sun, towards_camera)));
    float l = clamp(1.0 + phase * (-0.019 + phase * (2.42e-4 - 1.46e-6 * phase)), 0.0, 1.0);
    return albedo * incidence * (2.0 * l / (incidence + emission) + 1.0 - l);
}

float radiance(vec3 rel, vec3 n) {
    float direct = sun.z > 0.0 ? reflect_sun(n, -normalize(rel)) : 0.0;
    if (shaded == 1 && in_shadow(rel)) direct = 0.0;
    return direct + albedo * ambient;
}
