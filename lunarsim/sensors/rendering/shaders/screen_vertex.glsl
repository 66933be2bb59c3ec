// One triangle that covers the image.
noperspective out vec2 pixel;
noperspective out vec3 ray;
flat out vec4 to_cells;      // position of the camera in its cell, posts per metre, its elevation
flat out vec4 to_texture;    // from cells relative to the camera's to the texture of the relief
flat out vec2 depth;         // from window depth to inverse distance
flat out Light light;
#ifdef MOTTLE
flat out vec4 to_mottles;
#endif
#ifdef ALBEDO_MAP
flat out vec4 to_albedo;
#endif

void main() {
    vec2 corner = vec2(gl_VertexID & 1, gl_VertexID >> 1);
    gl_Position = vec4(4.0 * corner - 1.0, 0.0, 1.0);
    pixel = 2.0 * corner;
    ray = pixel_ray(pixel * image);
    to_cells = vec4(eye_in_cell, surface.w, eye.w);
    to_texture = vec4(1.0, 1.0, eye_cell + 0.5) / cells.xyxy;
    depth = vec2(1.0 / clip.x, (clip.y - clip.x) / (clip.x * clip.y));
    light = given_light();
#ifdef MOTTLE
    to_mottles = mottle_from;
#endif
#ifdef ALBEDO_MAP
    to_albedo = albedo_from;
#endif
}
