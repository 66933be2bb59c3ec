// Shades the relief, once per pixel, from its previously drawn depth.
uniform sampler2D depths;
uniform sampler2D corners;   // elevations of the corners of each cell: SW, SE, NW, NE
noperspective in vec2 pixel;
noperspective in vec3 ray;
flat in vec4 to_cells;
flat in vec4 to_texture;
flat in vec2 depth;
flat in Light light;

#ifdef MOTTLE
uniform sampler2D mottles;   // random albedo field of the terrain
flat in vec4 to_mottles;
#endif
#ifdef ALBEDO_MAP
uniform sampler2D albedo_map;   // albedo of the terrain over its mean
flat in vec4 to_albedo;
#endif

float ground_albedo(vec3 rel) {
    float albedo = 1.0;
#ifdef MOTTLE
    // The field can be negative at four standard deviations below the mean.
    albedo = max(1.0 + MOTTLE * (texture(mottles, rel.xy * to_mottles.xy + to_mottles.zw).r - 128.0 / 255.0), 0.02);
#endif
#ifdef ALBEDO_MAP
    albedo *= texture(albedo_map, rel.xy * to_albedo.xy + to_albedo.zw).r;
#endif
    return albedo;
}

// Plane of the facet at a point: its gradient, and its height relative to the camera, m.
vec3 facet_at(vec3 rel) {
    vec2 at = rel.xy * to_cells.z + to_cells.xy;
    vec2 cell = floor(at);
    vec2 inside = at - cell;
    vec4 z = texture(corners, cell * to_texture.xy + to_texture.zw);
    vec2 rise = inside.x >= inside.y ? vec2(z.y - z.x, z.w - z.y) : vec2(z.w - z.z, z.z - z.x);
    return vec3(rise * to_cells.z, z.x + dot(rise, to_cells.xy - cell) - to_cells.w);
}

#ifdef COARSE
// Distance at which the ray intersects a facet's plane, if close to t; otherwise t.
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
    // The relief was drawn coarsely: two iterations lead to the finest facet.
    t = meet(facet, t);
    facet = facet_at(t * ray);
    t = meet(facet, t);
    gl_FragDepth = (depth.x - 1.0 / t) / depth.y;
#endif
    vec3 rel = t * ray;
    vec3 normal = normalize(vec3(-facet.xy, 1.0));
    paint(GROUND(light, rel, normal), normal, length(rel), 1.0);
}
