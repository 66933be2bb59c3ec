// All that is the same for a whole picture; written by frame_block.py. Positions are metres relative
// to the camera, in ENU axes, so float32 is precise near it.
layout(std140) uniform Frame {
    vec4 right, down, ahead;  // axes of the sensor, ENU
    vec4 intrinsics;          // fx, fy, cx, cy in pixels; the centre of the first pixel is (0, 0)
    vec2 image;               // width and height, pixels
    vec2 clip;                // nearest and farthest depth, m
    vec4 eye;                 // camera, in the axes of the rocks; over the zero of the relief's texture
    vec4 sunlight;            // unit vector towards the Sun, ENU; zero where it has set
    vec4 surface;             // albedo, radiance where no Sun shines, McEwen's share, posts in a metre
    vec2 cells;               // cells that the relief's texture holds
    vec2 eye_cell;            // cell of the camera
    vec2 eye_in_cell;         // and its place in it
    vec2 lean;                // horizontal run of a sunray for each metre of rise
    vec4 across, along;       // from metres about the camera, and 1, to texels of the shadow map
    vec2 map_size;            // texels
    vec2 map_texel;           // in the texture that holds them
    vec2 map_dark;            // depth in the map from which on a point at the camera's level is dark,
                              // and its growth for each metre up
    vec2 heights;             // highest and lowest elevation of the map, m above the camera
    vec4 from_map;            // matrix from the map's texels to ENU, m, column by column
    vec2 map_corner;          // place of the map's corner, ENU, m
    vec4 penumbra;            // half axes of the Sun's disc in texels of the shadow map for each unit
                              // of depth; size of a texel in the texture of its bounds
    vec4 glow_from;           // from metres about the camera, ENU, to the map of scattered light
    vec4 mottle_from;         // and to the field of mottles
};

// The ray through a place in the picture (the centre of the first pixel is at 0.5), ENU, with
// length 1 along the boresight.
vec3 pixel_ray(vec2 place) {
    vec2 slant = (place - 0.5 - intrinsics.zw) / intrinsics.xy;
    return slant.x * right.xyz + slant.y * down.xyz + ahead.xyz;
}
