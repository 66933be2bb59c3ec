// The camera: positions are metres relative to it, in ENU axes, so float32 is precise near it.
uniform mat3 to_sensor;   // ENU to sensor axes (x right, y down, z along the boresight)
uniform vec4 intrinsics;  // fx, fy, cx, cy in pixels; the centre of the first pixel is (0, 0)
uniform vec2 clip;        // nearest and farthest depth, m

// The ray through a place in the picture (the centre of the first pixel is at 0.5), ENU, with
// length 1 along the boresight.
vec3 pixel_ray(vec2 place) {
    vec2 slant = (place - 0.5 - intrinsics.zw) / intrinsics.xy;
    return vec3(slant, 1.0) * to_sensor;
}
