flat in int rock;
layout(location = 0) out vec4 normal_and_number;   // number + 1; 0 is left where no rock is

void main() {
    Rock r = rock_of(rock);
    vec3 ray = pixel_ray();
    vec3 normal;
    vec2 t = cross_rock(r, to_unit(r, -r.centre), to_unit(r, ray), normal);
    if (t.x > t.y || t.x < clip.x) discard;
    gl_FragDepth = window_depth(t.x);
    normal_and_number = vec4(unit_normal_to_enu(r, normal), float(rock + 1));
}
