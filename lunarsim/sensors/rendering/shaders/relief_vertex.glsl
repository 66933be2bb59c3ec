in ivec3 post;     // column and row in the tile, and whether this vertex hangs below the edge
in ivec2 tile;     // first column and row of the tile
uniform sampler2D relief;
uniform ivec2 size;          // columns and rows of the relief
uniform vec2 eye_posts;      // camera in posts
uniform float eye_height;    // elevation of the camera, m
uniform float posting;       // m
uniform float skirt;         // depth by which edges hang, to close gaps between levels of detail, m
out vec3 rel;
#ifdef HOLES
out float hole;
#endif

void main() {
    ivec2 at = min(tile + post.xy, size - 1);
    float z = texelFetch(relief, at, 0).r;
#ifdef HOLES
    hole = isnan(z) ? 1.0 : 0.0;
    if (isnan(z)) z = eye_height - 1.0;
#endif
    rel = vec3((vec2(at) - eye_posts) * posting, z - eye_height - (post.z == 1 ? skirt : 0.0));
    gl_Position = PLACE(rel);
}
