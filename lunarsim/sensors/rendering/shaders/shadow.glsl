// The shadow map: where a sunray meets the level of the camera. All points of a ray share a place.
uniform vec2 lean;        // horizontal run of a sunray for each metre of rise, ENU
uniform mat2 map_axes;    // to the map's axes (along the Sun's azimuth, across), scaled to 0..1
uniform vec2 map_origin;  // place of the map's corner, in those axes

vec2 shadow_place(vec3 rel) {
    return map_axes * (rel.xy - rel.z * lean) - map_origin;
}
