// A texel of the shadow map that a small rock shadows.
in vec3 at;                // texel and depth
flat out float depth;

void main() {
    gl_Position = vec4((2.0 * at.xy + 1.0) / map_size - 1.0, 0.0, 1.0);
    gl_PointSize = 1.0;
    depth = at.z;
}
