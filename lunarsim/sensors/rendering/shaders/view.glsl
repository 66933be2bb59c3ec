// The camera: positions are metres relative to it, in ENU axes, so float32 is precise near it.
uniform mat3 to_sensor;   // ENU to sensor axes (x right, y down, z along the boresight)
uniform vec4 intrinsics;  // fx, fy, cx, cy in pixels; the centre of the first pixel is (0, 0)
uniform vec2 image;       // width and height, pixels
uniform vec2 clip;        // nearest and farthest depth, m

vec4 project(vec3 rel) {
    vec3 s = to_sensor * rel;
    vec2 pixel = intrinsics.xy * s.xy + intrinsics.zw * s.z;
    vec2 ndc = (2.0 * pixel + s.z) / image - s.z;
    float depth = ((clip.y + clip.x) * s.z - 2.0 * clip.y * clip.x) / (clip.y - clip.x);
    return vec4(ndc, depth, s.z);
}

float window_depth(float z) {
    return 0.5 + 0.5 * ((clip.y + clip.x) - 2.0 * clip.y * clip.x / z) / (clip.y - clip.x);
}

float view_depth(float window) {
    return 2.0 * clip.y * clip.x / (clip.y + clip.x - (2.0 * window - 1.0) * (clip.y - clip.x));
}
