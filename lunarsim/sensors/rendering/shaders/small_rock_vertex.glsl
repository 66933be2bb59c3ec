in vec3 at;                // pixel and window depth, from the ray that meets the rock
uniform vec2 image;
flat out float depth;
#ifdef STONE
in vec4 stone;             // normal and number + 1
flat out vec4 met;
#endif

void main() {
    gl_Position = vec4((2.0 * at.xy + 1.0) / image - 1.0, 0.0, 1.0);
    gl_PointSize = 1.0;
    depth = at.z;
#ifdef STONE
    met = stone;
#endif
}
