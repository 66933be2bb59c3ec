// The ray of this fragment's pixel, ENU, with length 1 along the boresight.
vec3 pixel_ray() {
    vec2 slant = (gl_FragCoord.xy - 0.5 - intrinsics.zw) / intrinsics.xy;
    return vec3(slant, 1.0) * to_sensor;
}
