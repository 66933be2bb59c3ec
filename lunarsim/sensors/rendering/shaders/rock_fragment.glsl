flat in int rock;

void main() {
    Rock r = rock_of(rock);
    vec3 ray = pixel_ray();
    vec3 normal;
    vec2 t = cross_rock(r, to_unit(r, -r.centre), to_unit(r, ray), normal);
    if (t.x > t.y || t.x < clip.x) discard;
    gl_FragDepth = window_depth(t.x);
    write_pixel(t.x * ray, unit_normal_to_enu(r, normal), rock);
}
