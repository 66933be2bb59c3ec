// Parameters that are constant over an image; written by frame_block.py. Positions are in metres
// relative to the camera, in ENU axes, for the precision of float32.
layout(std140) uniform Frame {
    vec4 right, down, ahead;  // axes of the sensor, ENU
    vec4 intrinsics;          // fx, fy, cx, cy in pixels; the centre of the first pixel is (0, 0)
    vec2 image;               // width and height, pixels
    vec2 clip;                // minimum and maximum depth, m
    vec4 eye;                 // camera position, ENU; its height above the zero of the relief's texture
    vec4 sunlight;            // unit vector to the Sun, ENU; zero below the horizon
    vec4 surface;             // albedo, I/F without the Sun, 1 for lunar-Lambert, posts per metre
    vec2 cells;               // size of the relief's texture, cells
    vec2 eye_cell;            // cell of the camera
    vec2 eye_in_cell;         // position of the camera in its cell
    vec2 lean;                // horizontal displacement of a ray from the Sun per metre of height
    vec4 across, along;       // affine transform from metres relative to the camera to shadow map texels
    vec2 map_size;            // size of the shadow map, texels
    vec2 map_texel;           // size of a texel in the shadow map's texture
    vec2 map_dark;            // depth in the map from which on a point at the camera's elevation is in
                              // shadow, and its increase per metre of height
    vec2 heights;             // maximum and minimum elevation of the map, relative to the camera, m
    vec4 from_map;            // matrix from texels of the map to ENU, m, column by column
    vec2 map_corner;          // corner of the map, ENU, m
    vec4 penumbra;            // half axes of the Sun's disc in texels of the shadow map per unit of
                              // depth; size of a texel in the texture of its bounds
    vec4 glow_from;           // scale and offset from metres relative to the camera to the scattered light
    vec4 mottle_from;         // the same for the albedo field
    vec4 albedo_from;         // the same for the albedo map
};

// The ray through a point of the image (the centre of the first pixel is at 0.5), ENU, with length 1
// along the boresight.
vec3 pixel_ray(vec2 place) {
    vec2 slant = (place - 0.5 - intrinsics.zw) / intrinsics.xy;
    return slant.x * right.xyz + slant.y * down.xyz + ahead.xyz;
}
