flat in int rock;
uniform mat2 from_map;     // from the map's texels to ENU
uniform vec2 map_corner;   // place of the map's first texel, ENU, m
uniform vec2 lean;
uniform vec2 heights;

void main() {
    // The sunray through this texel: it is at (place, 0) at the camera's level.
    vec2 place = map_corner + from_map * gl_FragCoord.xy;
    Rock r = rock_of(rock);
    vec3 normal;
    // Upside down, so that the ray comes from the Sun; t is the elevation, negated.
    vec3 down = vec3(-lean, -1.0);
    vec2 t = cross_rock(r, to_unit(r, vec3(place, 0.0) - r.centre), to_unit(r, down), normal);
    if (t.x > t.y) discard;
    gl_FragDepth = clamp((heights.x + t.y) / (heights.x - heights.y), 0.0, 1.0);
}
