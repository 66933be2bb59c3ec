// The relief, from the depth that was drawn first: each pixel is shaded once.
uniform sampler2D depths;
uniform sampler2D slopes;    // gradients of the two triangles of each cell, side by side
noperspective in vec2 pixel;
noperspective in vec3 ray;
flat in vec3 to_cells;
flat in vec4 to_slopes;
flat in vec2 depth;
flat in Light light;

vec3 relief_normal(vec3 rel) {
    vec2 at = rel.xy * to_cells.z + to_cells.xy;
    vec2 cell = floor(at);
    vec2 inside = at - cell;
    // A cell's south-eastern triangle comes first.
    cell.x += inside.x >= inside.y ? -0.25 : 0.25;
    return normalize(vec3(-texture(slopes, cell * to_slopes.xy + to_slopes.zw).rg, 1.0));
}

void main() {
    float window = texture(depths, pixel).r;
    if (window == 1.0) discard;
    vec3 rel = ray / (depth.x - depth.y * window);
    vec3 normal = relief_normal(rel);
    paint(radiance(light, rel, normal), normal, length(rel), 1.0);
}
