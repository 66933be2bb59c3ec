// Upside down, so that the ray comes from the Sun; t is the way down from the rock's base.
flat in vec3 fixed_part;           // sunray, in units of the rock
noperspective in vec3 moving_part; // its place at the level of the base
flat in vec2 depth;
layout(location = 0) out float dark;

void main() {
    vec2 t = cross_half_sphere(moving_part, fixed_part);
    if (t.x > t.y) discard;
    dark = clamp(depth.x + depth.y * t.y, 0.0, 1.0);
}
