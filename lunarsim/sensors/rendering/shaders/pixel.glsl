#ifdef TRUTH
layout(location = 0) out vec4 grey_and_normal;
layout(location = 1) out vec2 range_and_id;
void write_pixel(vec3 rel, vec3 n, int id) {
    grey_and_normal = vec4(radiance(rel, n), n);
    range_and_id = vec2(length(rel), float(id + 2));
}
#else
layout(location = 0) out float grey;
void write_pixel(vec3 rel, vec3 n, int id) { grey = radiance(rel, n); }
#endif
