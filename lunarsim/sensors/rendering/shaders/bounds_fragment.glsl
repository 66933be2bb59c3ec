// Minimum and maximum depth of each block of the shadow map.
uniform sampler2D shadow;
uniform ivec2 last;          // last column and row of the map
layout(location = 0) out vec4 bound;   // minimum to compare, maximum, minimum; see spread_fragment.glsl

void main() {
    ivec2 first = BLOCK * ivec2(gl_FragCoord.xy);
    vec2 found = vec2(1.0, 0.0);
    for (int row = 0; row < BLOCK; row++) {
        for (int column = 0; column < BLOCK; column++) {
            float depth = texelFetch(shadow, min(first + ivec2(column, row), last), 0).r;
            found = vec2(min(found.x, depth), max(found.y, depth));
        }
    }
    bound = vec4(found, found.x, 0.0);
}
