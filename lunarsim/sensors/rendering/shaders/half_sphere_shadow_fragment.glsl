// The ray points away from the Sun; t is the height that it descends from the rock's base.
flat in vec3 fixed_part;           // direction of the ray, in units of the rock
noperspective in vec3 moving_part; // position of the ray at the height of the base
flat in vec2 depth;
layout(location = 0) out float dark;

void main() {
    vec2 t = cross_half_sphere(moving_part, fixed_part);
    if (t.x > t.y) discard;
    dark = clamp(depth.x + depth.y * t.y, 0.0, 1.0);
}
