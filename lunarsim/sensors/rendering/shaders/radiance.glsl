// Radiance factor of a point (metres relative to the camera, ENU) with a unit normal.
float radiance(Light light, vec3 rel, vec3 n) {
    float direct = reflect_sun(light, n, -normalize(rel));
    return (in_shadow(light, rel) ? 0.0 : direct) + light.surface.y;
}

#define GROUND(light, rel, n) radiance(light, rel, n)
#define STONE(light, rel, n) radiance(light, rel, n)
