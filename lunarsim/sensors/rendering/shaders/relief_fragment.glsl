in vec3 rel;
#ifdef HOLES
in float hole;
#endif
uniform sampler2D slopes;    // gradient of the two triangles of each cell: east, north; east, north
uniform ivec2 eye_cell;      // cell of the camera
uniform vec2 eye_in_cell;    // and its place in it
uniform float posting;

void main() {
#ifdef HOLES
    if (hole > 0.0) discard;
#endif
    vec2 at = rel.xy / posting + eye_in_cell;
    vec2 cell = floor(at);
    vec2 inside = at - cell;
    vec4 both = texelFetch(slopes, clamp(ivec2(cell) + eye_cell, ivec2(0), textureSize(slopes, 0) - 1), 0);
    vec2 gradient = inside.x >= inside.y ? both.xy : both.zw;
    write_pixel(rel, normalize(vec3(-gradient, 1.0)), -1);
}
