uniform vec2 heights;

vec4 map_position(vec3 rel) {
    float depth = (heights.x - rel.z) / (heights.x - heights.y);
    return vec4(2.0 * shadow_place(rel) - 1.0, 2.0 * depth - 1.0, 1.0);
}
