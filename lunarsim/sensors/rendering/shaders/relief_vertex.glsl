in ivec2 post;     // column and row in the tile
in ivec4 tile;     // first column and row of the tile; its last column and row, relative to these
in ivec4 edges;    // level of detail of the western, eastern, southern and northern edge
in mat4 placed;    // from (column and row in the tile, height in the texture) to clip coordinates
uniform sampler2D corners;  // elevations of the corners of each cell, starting at the south-west
#ifdef HOLES
out float hole;
#endif

const int SIDE = 32;

// Along an edge, a fine tile uses only the posts of its coarser neighbour, so that no gap appears.
int snapped(int k, int level) {
    return ((k + ((1 << level) >> 1)) >> level) << level;
}

void main() {
    ivec2 at = post;
    if (post.x == 0) at.y = snapped(post.y, edges.x);
    if (post.x == SIDE) at.y = snapped(post.y, edges.y);
    if (post.y == 0) at.x = snapped(post.x, edges.z);
    if (post.y == SIDE) at.x = snapped(post.x, edges.w);
    at = min(at, tile.zw);
    float z = texelFetch(corners, tile.xy + at, 0).r;
#ifdef HOLES
    hole = isnan(z) ? 1.0 : 0.0;
    if (isnan(z)) z = 0.0;
#endif
    gl_Position = placed * vec4(at, z, 1.0);
}
