// Outputs of an image pixel.
#ifdef TRUTH
layout(location = 0) out vec4 grey_and_normal;
layout(location = 1) out vec2 range_and_id;   // identity + 2; 0 is the sky
#else
layout(location = 0) out float grey;
#endif

void paint(float radiance, vec3 normal, float range, float identity) {
#ifdef TRUTH
    grey_and_normal = vec4(radiance, normal);
    range_and_id = vec2(range, identity);
#else
    grey = radiance;
#endif
}
