// Bounds of the depths of the blocks around each block, along one axis.
//
// A distant occluder must be high for its penumbra to reach a point: the depth by which blocks are
// compared increases with their distance. The first component is that depth; the third, the depth
// before the increase.
uniform sampler2D bounds;
uniform ivec4 spread;        // last column and row, and search distance in blocks
uniform float growth;        // increase of depth per block
layout(location = 0) out vec4 bound;

void main() {
    ivec2 here = ivec2(gl_FragCoord.xy);
    ivec2 step = spread.z > 0 ? ivec2(1, 0) : ivec2(0, 1);
    int far = max(spread.z, spread.w);
    vec4 found = vec4(1e30, 0.0, 1.0, 0.0);
    for (int k = -far; k <= far; k++) {
        vec3 depth = texelFetch(bounds, clamp(here + k * step, ivec2(0), spread.xy), 0).rgb;
        depth.x += growth * float(max(abs(k) - 1, 0));
        if (depth.x < found.x) found.xz = depth.xz;
        found.y = max(found.y, depth.y);
    }
    bound = found;
}
