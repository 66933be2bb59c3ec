// The relief, from the depth that was drawn first: each pixel is shaded once.
uniform sampler2D depths;
uniform sampler2D corners;   // elevations of the corners of each cell: SW, SE, NW, NE
noperspective in vec2 pixel;
noperspective in vec3 ray;
flat in vec4 to_cells;
flat in vec4 to_texture;
flat in vec2 depth;
flat in Light light;

#ifdef MOTTLE
uniform sampler2D mottles;   // the ground's albedo
flat in vec4 to_mottles;

float ground_albedo(vec3 rel) {
    // Four standard deviations below the mean there may be less than nothing.
    return max(1.0 + MOTTLE * (texture(mottles, rel.xy * to_mottles.xy + to_mottles.zw).r - 128.0 / 255.0), 0.02);
}
#endif

// The plane of the facet at a point: its gradient, and its height below the camera, m.
vec3 facet_at(vec3 rel) {
    vec2 at = rel.xy * to_cells.z + to_cells.xy;
    vec2 cell = floor(at);
    vec2 inside = at - cell;
    vec4 z = texture(corners, cell * to_texture.xy + to_texture.zw);
    vec2 rise = inside.x >= inside.y ? vec2(z.y - z.x, z.w - z.y) : vec2(z.w - z.z, z.z - z.x);
    return vec3(rise * to_cells.z, z.x + dot(rise, to_cells.xy - cell) - to_cells.w);
}

#ifdef COARSE
// Where the ray meets a facet, if that is near.
float meet(vec3 facet, float t) {
    float met = facet.z / (ray.z - dot(facet.xy, ray.xy));
    return abs(met - t) < 4e-3 * t ? met : t;
}
#endif

void main() {
    float window = texture(depths, pixel).r;
    if (window == 1.0) discard;
    float t = 1.0 / (depth.x - depth.y * window);
    vec3 facet = facet_at(t * ray);
#ifdef COARSE
    // The relief was drawn coarsely: two steps lead to the facet itself.
    t = meet(facet, t);
    facet = facet_at(t * ray);
    t = meet(facet, t);
    gl_FragDepth = (depth.x - 1.0 / t) / depth.y;
#endif
    vec3 rel = t * ray;
    vec3 normal = normalize(vec3(-facet.xy, 1.0));
    paint(GROUND(light, rel, normal), normal, length(rel), 1.0);
}
